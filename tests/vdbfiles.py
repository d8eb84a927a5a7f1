"""Small OpenVDB and NanoVDB files, written by OpenVDB 10.0.1 and its nanovdb_convert (Debian's
python3-openvdb and libnanovdb-tools), packed as text.

``several`` holds these grids; values are single-precision unless told otherwise::

    density  background 0.25, a box from (0, 0, 0) to (15, 7, 7) of 2 (tiles), and VOXELS
    heat     the same in half precision, voxels of 0.5, moved by (1, 2, 3)
    mask     booleans
    v        vectors
    empty    no active voxel
    big      two voxels far apart

``root`` holds one tile of 4096^3 voxels; ``ramp`` holds RAMP, in 32 bits and with 4, 8 and 16 bits
per value.
"""

from __future__ import annotations

import base64
import zlib
from pathlib import Path

import numpy as np

VOXELS = {(-3, 2, 1): 1.5, (17, -5, 6): 2.5, (20, 9, -2): 3.5, (18, 3, 4): 4.5}
TO_WORLD = np.array([[0.5, 0, 0, 1], [0, 0, -2, 2], [0, 0.25, 0, 3], [0, 0, 0, 1]])
"""Of ``density``."""
_K, _J, _I = np.mgrid[:8, :8, :4]
RAMP = 1 + (_I + 4 * _J + _K) / 8
"""At (8, 0, -8) and onward, with the axes z, y, x."""


def write(folder: Path) -> None:
    """Write all of them to a folder."""
    for name, text in FILES.items():
        (folder / name).write_bytes(zlib.decompress(base64.b85decode("".join(text.split()))))


FILES = {
    "several.vdb": """
c-rmVO=}xR7{KwBBPU96TqU(b2%(75OEHGjl9T2VD{W{?!O$0{$8Kh&k+XDPgmx_?TBr)8^w>klp{HDX>MiG-a_$Ex#UH`PKuFX
X?XF&&DDs;cS^odXF!K1>nbFK@0@8z(`}p>^hO({7TSg=$t(BERY32Izjg{5%a-np+vMkDFYdLSpk3{)K<?4smS9RcNRnDkVmR?
|o&8&L3QIpcFIKBwYRkL8`b=Z$_zkl41>iGvztuN20a!!?s?MTzI{D$d@#;j_n%TnH+Qx6tYIU5hOE7JA`BA>V0?PsdIP$ip0mV
CEblR;qno*pj<Yqqz!s2*94ACz)SIZ+Djy3Eyuvn7M`$z^5fh^8!?>Y0@FsAkfl8?LH`v@z()h<ZNh*_EzoHA5Nbx!YcNt)SQ7>
7xssu<pF;enUEH_FG;!5SWe!zNi}mGZ1w(OA(m&gj0zYUI$pd@1%@)nx1fF@45GFm|oUfm5S}jby1DF-Ci^H<?mtfk6+!qlf)OJ
DpO3_JJU5<H<MW#JMFds000000RA^AmH+?%0001tTQ;s|Qu$79K&r0|(~CErFy@0{X85lrAOndP000000000000000N94_9AMw#
YaNG}u;-LnJGLTxVGynhq0000000000$J`jRk6NrQaMBKj;@-y~2@wDQ0000000000fGIGp>?0Bjj<*#1d$L{XI~X#m&h*-f#;b
FT#`HJShJ1tDLf-`S(UtDDJznbzD;{Xf;hpD3cUU}d=XVdktiwD1y{I4GlOnvV>W!L|X2tPEXs((CGjDz_oXV&AXC3?HgQ%B(KZ
suFUo1uS>G)1Kr%J_kq-j}x!*oSsRyEXRDR0lk<DFII%*&CsHxT)}-EKcq<%KHQB(mhY)tU?f+xPT%L0GfB%|-Rda{Qo_Tgr)2X
xC+~E}ShHoKG$*OGh+i*;LP=tVcDI7Ts_)UW$H~N7VC4&#rV$s~O5b&)xRIYX!XqPaj?A?oTJI?l+{PX20cy1A*yy;ETF3FauFn
vlM}OPpx>g1v<d;eMc{HO8?*qSN5KJvTyqJcgM3Ue$D-+BpkU>6JFqmP_Bz=G{nx@;60d$>+QAu)!ln|SDhVFC*$_&=zeM4G?Im
%fNxs_00000;3VPATL1t60000S3U4ssh|CQC)dXY|aiaqO00000000000B|hu5kGKT6c2TElu^`T836zQ0000000000K#L^+rd4
t8p(GCi00000000000000I2&R1h*xxC)5Z5!Qd^)Y_bkbIQWgby>JhK?`Eov9~CN~q`jh(ieeL=+ojX1RHTO%(m9<=LE4!xkmx^
CUp`{s(^`?poSQIpcNeBUuw&4QWN7yP^wy^`;L71g<~qxy7Q&Z$zd9d()IH%wPFW>rI7mh$%8t|{z_w7sE`*(9>$yVaTu0^9fWS
V35`z0F1S$a4Iklv~P)QfSv@t}dJ{8O$e_xzaVQW+($ag6)OZ3K{j_@t^6z-s^rtI%<q9FB}L=jxHVU30L-p?q91ro?Y>4?l&dj
$aPVTF4<WdZ@v9eof>xFasUGW000000000005AoT1QDI`q3cxKMq&WK!EodU!%-eAM=_VWeo~#3Hl1Y_^m5wn#5rt#HKKZ<*~@7
=V~oma)3G{*?vybqr>#HofH`gFlgrA|5lvY(9bc67sAkfl8y0u3*!yukA|>wOt+U-b;(#e}orRvne7M)#O#BZB0000000000006
)gAT<uao)3ne%ppfO;PqGfCZ<!%=DKYyo%&Q%|B5<eOS;vt+0A>aIKBvbd2j1+o?G^Z!Fq3bZ$|X}zn${>ytj6{{ZmrLn)jyXG$
O_A(rj;MUz_5Vcsa$byRH+Q=B85&Eqim=&VLr~^m|XD`kyEJ+4+aRri|a-F^peMjmmhu+kDaPe=Ut|=ifDU|Lw;syXq15MdrIbr
asOLy)WW5pU}IaGw*6|I{*LxP8#0Z0RR9100000Or_DeO?VUdU;-0)FdX{EY^6A1000xK#S#Dj000000002&-{fW=k$(eB+`*82
(=Y3VzKQ9XrMqpdwd^=M{|~<Tz8w
    """,
    "several.nvdb": """
c-rk*30PCt626g51tltCEJ(C!DNi<iEGmJdP_3ZALuCgeARs6z5QwbNf~bICSycqOfL3;l>`PoqqCyFRm;kcL5+Fc;5JEyo9toj
Pi+%Ka->3b)GT)rcy>rf;Id|?kbN{(9aX5G0;%j~N6<|OV1b~38_NxFs6^jT2aJ*hzAXm(u&Wu<<?vsy!MF{LZi4YuI$Ii+xBM~
S4xV*Xk@54aAwG99eDl(@Tfxj<Bg+AvR=sh3&bN-wi-CTh@p`D9&hg$Q)H<-x)b=t8q`I2c^BPH^rn2C(sI_06z)7#Je;8SWD3U
+`$aa_%N3?)a87$_ILgt%y(@`bb_EZSo3iX@gWTRSTxV?V!nxqN!0hgxQ-mRjM*p}G~sM?V|!JAJC<Rwd>*1q#Qkrl`oGNmt)CS
n`Im&|8{uxk1ByNIN9Mhp>r+-Orl9mgtq-We`brSPayn%)d2|>!NnhI0zez^?YvosxXrhVO(Il%hKA)RNrcCGn1BL%WQfSm>WJx
>O}=S_s!|gD{9fhC8H@~f}7jB@hV4L6u3{h#FPg9R&+^XTkXLI-+W}RKgVY(XDMz|mMEgb7$*g)yV<w=XQmS?6A|>$rV$FpNF9p
?{*DB@K(D$tP)*n90#vLAK>ErPpbw1XNPEU{p{wVfXII?9(Ef)WY-E#9mJs$np5CQ)%=AM(2}x>N=9x9vpU{z2dcK;#1(TQNvTt
I+2_dC5gl}l%>EKr+3BaTYI%Z_sWAc9PDOx}4Vm1W<kQFP>+N=ZsQPD+m572>|mCC{##1ZBWMTGEbp_D~T^LV_enZ})IGBX;!d5
L*D!t3gU5<twj1Vk4!(1QH8F!!8tKIiR*@&k%j&F3HZc{ykK$D@?Bv9HZ{#(b%tcST83<owodP<|e2aL`CSFAfADugHD8-tp@ov
6{%y$C7=J!j;#zta@<x4h)t<Lya=(Id1EbT|`SZ!&?veR`Gfd%w46YvrDmEkNu8r%H>Su@{Z=%Nrsp{%le%71}di(jbpQ4pxXm^
PFC-Hb!v@W1{;wNtx7C^jbpzJ_6b1y+DA5e4(Czx%kI>)2fpDJlS?Z|58bnUT06O%Aq<s}ol~}nLL`wecG;8zKEY+B!yzx3yQoB
3)7viD&K1*p0=QRFNiMS9l9D0Ej-{~ko}BFU3^sxG?0bQ|eO{WLWkDiVo{ufR=UIcnhd?LL`$;3851G{3bvPI`Xa;HYm20OnU8v
K8ZMUOGymm%IQ7Nf87`ETW?5>A&cf*(+bBu~t9ajjG^I&tY_?Kq1C+W|3E%V1<KV$AAS^xaC3sue}x_o+^g$=>^ra)E73O}HR;P
<7ayY13yFo(Ah5c3yw%dv<dbrC){m&5sSxow>`U5b7;EzSg*_?1AVVipi_;?nFx>pz%(JBK~07iP<>?)1WNmm~J+xbn@t8?emAx
FMaL{L}j6Y^(7Vf}VO083PD`(z2}$ezBDPvI2**-J;A6l3I@1r{jle3isn)o_)1nH6*R<gy-<a*jAU)0Rk2BSIks+Rd9_vb*-fh
W6C|}5-KAHQCh-Jrj){sN&OknT&Lgm^3I~*Y@T#Fl)7zc_9<nzU2jo#q@&oyQuPIoiu%O*j6bVdFwbruIrw-$%aSLYnD4fo=&tG
PlXDvRdZ2u&;H_V9Iim`UA7%MoV@jtCquSvfulO?_n;563?s(zsJ#M=)$Vy_#9)c$JrXP2SXnL{7t{AJDJg9Yyr;CR;<!CjK>JQ
{Txm8W{Zv)Bq=;B{yCWT!bt-$veI{tfNQ$$if3G?cVIv#?}!rn#$&tQsv(W7@TamBynILRdC<J9qX&Icz5`0^g?cW8jty}3q9#C
|HGz?&)WeZy(SLT{n#ASGrue*7d?;xo!l;14)dSWmhO@g6JdaKQVuC!cr%qG3KDd5cKQT;t>H1#Qt9SbUM1cd;7S+2g_t3UvhLP
$>OyO|`VQ=N>DR`BMfQtiDP;kF1UWwu5)68;~EAi0zD*+P+zXyrFl)PvUYskvn_$Z?#CV>Fr41NsH5{o^`xeZiB-ib&-=Q&m`rq
9hX3Ttt%x`vgXjOF9D!?rG@^7aC?Ff2fsD$7EJZear>ME5WmOm^1sQY;r4kcwnW^1+SvgGL@faA`RC=#XFxmps^LJ!dc!!e>rak
Yvm}nf!IJA8Px*@P_`>R>G)F7}ynO)qc=ZPNgWS+aYx3>V(C$(Bmi-j}2gw?>_OpO}!hR_6xmSwKVb(xj84btfU`@G`V>H~+oVT
kgC=NE?xsFiU8b^!T<)^_~Wu2>woQ5jHS_oL`JI-FT1t!a8S86UCS+SAGvkfR$ESMsmIDrmseNq$cp0XxMIYGHM19>kOH$ty{{j
PaKSliP$NlZ2=$^ScK1I163K1gYqhP7a+bS514+H}kYzniz&6cgx2E)L_>k96b3Qqnc78weG6tWuD=J?*~fxxmoOczNA3<(P-u7
bNr7QPud&o%36?-rlDF-%@8h##mQa8a|x6%Ws2^%VQ^|-4s!dTNbKnhkN&#DtR<URc{rj9&y79Hwg~w@fz0}H5zXacQ1h6EDJ7O
`S&K4`D1YOFVnDTSfWyTRo9+Ff?{dSK=F{+?4gf#`0SH{6(h&Br>Kg{5&LwT?1sfqPg9DqHC#!cQSdm>B00N*q|Kxp<dIuKC&$O
DI?uRbFc{yu2@2%Ua?m~*pRz1Jq!i!uqpzK~VRVIK|3<}U?so?8Q-2AJCwrl}Nl$eiD#Yw4@kP_`-j6GEC(!LLKdPL`rQfHoanv
;S=?aPzj(<Vu?jW&vKcJj+muBCqWXg~2r+UmNg5Z2}IK6AeW|5mrrdx&_O$hLr9-KOw$C7t_8$P3A=Dn`u%G}6^a97dE{k4|bm8
=$~9+kURKhU53E|0}YD{Lnmis^pVPk|f8B=z<cflKq&E;%M;g9nTr)W|mIROfkV+xzdya^b>eu=uc6EVI6lbh2j1RhtIX(iNPj3
}XYkpxk`&RtqQ0tF|MRJdfNb5T}}ZwZUzmak^cvE?$mn_D;4e$}9`deG2hT+}s3}qel@>w1LVK?`yY8X$-0PCJgV((Tr*&BX3<z
$xl6uhcsMfL5nyFZtp|OlRwX5$Sxs<%;K^^3n8WClD>rh5nBJ%@nS-s3)^B)+{3~94A27l4O%wu4u6V}0qS;;n+DhYvf<*TD{CS
Odfpf+Jyh)zQ-)o;(UA}PR@<s7ZDj}~ME}Q1iD$%A7M*n<<EEh=Z)!6p`d$Q!!ZRFO#|Sgqrk8z|qyy*mR$Gt1u|P6dDw>I726@
m@2FEN&L6g8B<Jtz#=Bc#droX?I<ONr8va>dKP{`1cc3wk`4P)@Xtkd1u$^6+})OBMaMSy=YA(GREKz*UbGe3_|trMdEV|d*@!$
8-N0NT|k+|}(9e^{r8*>d8rFs8omm2BdRuCKY$XC-3sb1-7Agb`U#&WQZUI$g2Eb?OTk%>QZH{FRAdk@h2ww0er#7c)ioKuD_gB
+0&7pXd&ia`A8WoInt?4u*@#IUc>ttZ!#ET!zCPo_>2FfH!gx?HyDS7~mI7e5ZUQS3mQ)S$e}4nAL=w6rLV*>`o<%+D!K`An`J4
JA#ht#67_19iFD0A;b<P6^N-d(>K*tyIA>ZyVv$vX8p?of6J*p7Ok0jKsD*8cCM^QvlJtYk~9%*5YE3biB1X)%wNTwO<Y_E$|8#
N8L&+MRLa{FF29>_N+sG!s|sfp*$QmWq_7gk;!FJsChd%mDT@Ao<}ZQy=F^h#w0JK<I0M#xw35Fhb+lIv<~Py=`>Mk#5HKm&9rs
^l0zX;
    """,
    "blosc.nvdb": """
c-rk)YfKzf6h8Ovz{~>i&MwG9qj#2wL_uH)Rn&B6N~qdIDQLu`Q63GACEDF6G_jh<XwsxA>I#~eP^|Gs`$u9(P5EV5jV86fu<?P
334|#A0->cy%Hw+O%pfcB`pt58C-<H+=iJ9P=X`VT)U`%qjkPruR0o9s1!E`(viy+eRFF@#7msKFisH%ylFRt8TbCx>ddYO_V$1
XP>RfAC2(gIQ3SK#=@#Ceg_2c=Ccr{o!Bq&Lj9G51IEZcI<ZO5V=?VYFKdvCs!gcNrTx}(d-)+CBO*vVL3<F|rFfEdu$jy-nWMt
b3zYT@D(Du-EKT*>jPa=66kT@XyDkRwzGT7C$Dt-(vnl;EFc0iz(?GLjkA)}+)e>idDkbo^7qRmwUihT=5#&=Hrqa{L%sD|95~<
K$9OI8+}Fsw#a{!{#g}REEoJ`Fw`YY3%N>`J~=qtJfqewbo7u9fct{)`{73=ILH|6Ue9Vlp+zh1w!UYKLnQ2;Q-QL$PZxw2Q&x+
v}zC#KG;hz@pt(f9`9hezA-4@@jtGx^}1BTu5KMJ5A#D#?zzHV6p5F+ibrKu4s`GKm3s8^o1~v;&96cVL5QBhBnk)ZgYcP+3L7j
N#&z&f$R5#vQV1hW8E`Xw2JdPx1LIH%OHhoPtXvo`g~}l4Rnj~p#1J&ti8u^r17XmBJ3LSrgc)cKb7ie(uK92xkx0|How`x@JJ(
@hmBM0x&qS<o+I-kB42h4fdzy<pE1|BoQ!#m)FpmBcLv!JlmKLAJ;tM6*Z$arEqlp;%H-eVGh{HLV=V`F}lk99gvX>1%A-@gADy
|Fn@Y<0sqow$o>YOqY5CIEpWH}fH)3VGwAjouyBIvLj_Omk}Fq{j$7Fw8SlgNTFwlaV`DElE_<3O^b2s-aKz;_%-uDr3H+6qnc9
*sv*nAsRzCAPW$6PsmOY02<hWZ$S892QchJe$mGGu$TfIP{l<i7M>9g%W1LeS6fFOl?aw2+sb@RLC(Twg~>lkkI&A5^Y}gb$Q>c
%0iQz+=R*PBd0Lte#y~8f36x&aAP*jZEfOT5p%zA=pjdZh+D50Y-qRU|JFfy`ma8!XfoDMurtt%hyOWjIVPRF<+M-MTg=!lU#71
b&C;UB#3^4Oq6dX06KB#1O|CxZQ#}2)XkFOZaXOa=GP#&$0e7(o&qp&F%9}ghy=oib1<^Y;w{m;vD=!}XTxR_o?@x2;ExHCSmhy
y9SpgLy$bO!d%3F7|k>1D7zi>ltynF6t_ZMz$o5^XlC8ls4-E4WG(Zubj_pE>61Xn+`#T1Lk2kq>`_8AlRXRcEfi}KCKDwci4Nt
%K6Y$a}6RKmWbB97uA22|4GmJdnIxV<JovyEn48rYa65uRuueVGNA2OwvjPao$-5$VHT#@Q2(5IHf_q1ew`2B9AtWhA6zqIEnT&
!=zm_&k)!G4=8Y>;Ty+Hq`wN+CLLEP4fh7k1nHkVgOwp=tif;Ldz<<!8~}cvI#f!e%xfuCVAy~MAuECC*OU}b9`V25VHkCX4}bg
l0Ti#?#EB#lSGK8*;QkU`CdV<k{t2XfJ&hmmk1FDWfM_8if?z^1J$-ERPL%QiM8cnU5RhDsX_E%`Sh?vn_Z@3+3;98*YoMe>^vD
m<&pY`EdK!MEVVf
    """,
    "ramp.nvdb": """
c-r$z%*zjRaWY^MU|?ZnU}R9(z`_6mEX-hvL4t`RCyE2eV1)3Y6ci{pFre}eKxhpIba@Ua{p0`t|J*>D9f*O<{}9m+_UJUsN@R=
-Kzxv!Q&RJaGfOHN{xCtrE9ShtrRX0WD8cr?+x?PShoZXnM2Sf&zoyJ|$X&sDa*}Rh+r*rt;&254VGft0F09@H!X2C{_K9hH2mK
H5mVcjGc5}h>Y60c5*PeUcn^X6F+U3t}vsc;GZv6V}=j7w3)9vTgu6N4bIHNwK=Zxzv_s`SU$M3sU_50V|_N20@d;iqT{(j}`^X
u#4%Wwa#&z^thZ{Dt|z12oh(}Vv0ef?Z|ZSh%ovs*7ezxZkWy6@V-AHUY~&-kqz-lJb~?6IrOZSIZRln+1u^Zj@G|K`Ux@@(g>`
=b6U{OaG+rH|V_-`!HLeHj#VKh{sVYzOjd!Sz}7@dm3e{rE1!Fp|N6CFd&ku2_|&c&$t&E^Mvlyv}+L%eTx0+fT&>$}C?L;lEt_
@4YSl%nWDNZ83f;jNh!YR*%0fTD7YBZQ1HmC*DVV>w07%dbG+a_T_iC&v7XNmR)mP_PL%@dTv@QSbw`y$4zd@$(_=XT{`Y^*Uo5
el8W4IbNI;~!J9of?)R>rNlj7TB>gkO_`T~l<-aGE&#Dx#?2vKWx8&Ko!+E}Uch7vMdAU~k^4>Eg_fMC|r|gnn3Xzy@bT{1iuDS
8ua-+N7jqmas-QB+oDr0>2y3yV3KpEq^zh}N{pZV_ad&Y#YzbtZ1sv!Uwj~nv
    """,
    "ramp4.nvdb": """
c-r$z%*zjRaWY^MU|?ZnU}R8O$-)2v=b6A1g9H;tP80`_!3g2=G9Uv52L@FB0SK+(fG*DgrGNbY|DPL3vjZ`Z`5z+s!5*E4S&59
10f-NBb4qGnab`&+!*Qs4E9ShtwclSjQG)%$;t3+oJm-95Wqo%YcHOPTZQ3*G2AjByiAf%h+8sZS7tbDD_{ZuY&TjtBe?jMeh9g
H>Pkx>_&86-p-z2x6HIvNG?|pyw``+i1%J-yaORt}QUC#d3l=}LpmP^ekX@-(Bx&mLGnG?G|CudLP*Ke^!<+-}O^ZGxZDgB&3{h
Ge?_kZ_qrC<5$RaLn6Q)Phsvg`Nv-?_iw-v7_1*{o}2=ImcT)$y-EjD7vVEBTL`9v*sAP$iXKt(RqaY<+RvznZPPg!jH#ez)~%N
oDQ#Q{Tmp{)wzDbgnml8!z=Y6X?qW|C6&Xfumx3_Lcvv<)K!8<})*lWUwQvEW*Eg(Twh>KEdg(nN7AI`ESlDVZO60t2ABH^V{Wj
hq89<*|*!|WgSDqZtYt8mwb4QdyuyIa8;DZ(UP4pT5b~Q=cC@9epF&K|Bm;v$*(3y?G4K}kv@B^EZh3_>2J60mVIAPe&KZgr^Wv
~w{8oHUukYWd-mEjQ&Zorx%;wg*WSbT67QY=eOz5I-(`>JN1aD+JLFw#`YY@o*(=@asnCA3@NQ>?{-eqx{mOP>`?tST_lh|12LK
An{ND
    """,
    "ramp8.nvdb": """
c-r$z%*zjRaWY^MU|?ZnU}R8O#liprkD0&}g9H;tP80`_!3g2=F(3m42L@FB0SK+(fG*DgrGNbY|DPL3vjZ`Z`5z+s!5*E4S&59
10f-NBb4qGnab`&+!)>U0E9ShtwclH;P=@`(=acR30;}vF7G@W8C`4)XXB8B2x`=BUTySld2@;s6s4lK97*ljYF=|c?Q+q~HVNv
F!11D9bq;f92KKESt$@+Qe9&(qibKBLt+gJYneeJu4$I>4>J@VwiX7%#l_ho$2cV2qC<a6Pr3lqb?IzPYo@x|)S>yLvkpZps7I=
k-PDck3B|66RWi&}mC|5dxQ>%uQjetq?PZ=JgB|6ebEO8tFyU;f&Sm$i?7{|?LjQogb7PeY&mtColtU6=p<x&7{3wd(pu*7p1Ue
@HN!zjWTT)6Op=&R?4O{rskA_rFJ3KgVvVU-@%2C=9~g*WP6Yd3^fnoBz4jtv3009zCc=7MOEYwATLgrgwY7Kb_*=93-9o$UZ3h
J44K}!_7DMsjOW7^izP<war(qzpG?uc&%M~`yD4<;~pf%Ui`jUXLsPrDVx-yZhj8l`)`B!$w^0_)Lp86e{k{gzs%>mrQ{@K^|Ok
ymW5rp^XE`f;A!pE^4(F<_kRRkd3NpF^+jc6-}kxKSUj36IKTTx(UI#)`y@Zk?fBpG!{f+uB|G_#Q#;nX*JwZ5E%;yb<He5iE;W
jeRtw(m_)&J`yVAW&?@OotWqYo}HwOUAy%qi
    """,
    "ramp16.nvdb": """
c-r$z%*zjRaWY^MU|?ZnU}R8O!@>Xp%FJMjL4t`RCyE2eV1)4b8IXa30|P4m0EE_XK$qu$(m($H|IZDi*?}0y{0|ZRV2@72tVG7
h0K^BmIVCl(IJ2aZK^p4biaBp@+4~3w%CLW6o+xDX;s{T7;fsWxg?e7jGBE{)h8qNYUL9~^k9@<_JU3znho`vgk=D*uz6k=$^?c
^WNU=}z%R1!XbE5KA+@r_+sS`{NJ)gYi&%3?lmG|$f=I=?@7x&Vi=W}njaYeD7-<SJ+Y;x|owI?O+%KZ2nQ?vC$RozG5l3HE=lK
JsZ=5Bs=-*3(Ql8b-qOZ~S0z38;VZrAm7<=pA-=f7DWoB!8#P3@)jZ-0Lq-CFnF>UE~WeR<^zkrJ<b`X}w4>zkz}x&K||uYdPG2
3_)AYart*&UXB|e{H?Y_T6)=m+$|4?*03JnLzIzxVrJqYc?RG;q=wF|C?T~y6|&8Gs8#*7P%{e`yW}HQ!}01^ThDo`$Ydg?$fI8
GEC2WUy-TQmDTz%W0!%&KD&#r>lhkdul}&@x-4Gv4*YDh`l`|QSbC;U{hgz(=hnDxZJ!z=<G-%9KHy~Uo&Ph=+pqFJXOrtYb^dZ
w>)^R(Ma!RGwhGPCn|A7AQB=5gvUc?9$=R8?A>Hr!&9!D{%HF(n<J|je_Df55-Mgi4-e$ji>#Z}gZ?-Jk*Y@(}OoQ50BFol?9s1
&C>LY)X>+<r~iB(%Amznb){_-kk#=RJx%g2F|kA54}CR_XDziofHv)Q2bq5F(^+HEhF7R}hVRce`hUdzj$cMbO5;kaBLmH6xEJM
Qr7{@aS$R{{WD!6fn
    """,
    "root.vdb": """
c-pm6O-sZu5N*X(5kJ<0;IVfpl(t*jld^c!lONZRrc(*zV`;Lb`)~Ir_z!gA8rH5}9eBK9c$0ZEB%0s91{iC^aj=OHlBBA$qKvD
A=5Y>?#Z`7w#%Vh%5|&qKTDD(8#6F_a+D?(5I{?xOO)Z&`oMcY3`hN6bZ_EdXL&Pbf<pM}u>w!o*Ot8=c%lHW<ALm=_D7hLbf5y
}+nU;$VjNw|jdB%2Jy<K8f3vF0*9Z_a^4^dCW63m5fYe3KyGz2$k+*IN#uHXiod8GtN>XilKyl`cU{0Nh)$&Qa+4<OLZQrVHvi`
)?vm9RDG&x(5oFN(LilTVBac%+L>+xzYR^7<Et{(A&}#$EUc_qA|+
    """,
}
