#!/bin/sh
# Makes .venv with nonexp (editable) and its test tools in it, and a usable LLVM present.
# Installs the system packages python3-venv, libatomic1 and libllvm19 where they are missing and
# apt-get can be run as root or by sudo without a password; otherwise says what to run.
set -eu
cd "$(dirname "$0")/.."

# fail SENTENCE: and what to run, all packages in one go.
fail() {
    printf 'setup: %s\n' "$1" >&2
    if [ "$(uname)" = Linux ]; then
        printf '%s\n' "On Debian 12+ or Ubuntu 24.04+ run this as root, then make again:" \
            "    apt-get update && apt-get install -y python3-venv libatomic1 libllvm19" >&2
    fi
    exit 1
}

# as_root COMMAND...: false where that takes a password.
as_root() {
    if [ "$(id -u)" = 0 ]; then
        "$@"
    elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
        sudo -n "$@"
    else
        return 1
    fi
}

apt_updated=no
# apt_install PACKAGE: false where there is no such package, no apt-get, or no permission.
apt_install() {
    command -v apt-get >/dev/null 2>&1 || return 1
    if [ "$apt_updated" = no ]; then
        as_root apt-get update >&2 || return 1
        apt_updated=yes
    fi
    [ -n "$(apt-cache madison "$1" 2>/dev/null)" ] || return 1
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends "$1" >&2
}

# ---------------------------------------------------------------------- Python

python=
for candidate in ${PYTHON:-} python3 python3.13 python3.12 python3.11 python3.10; do
    if "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 10))' 2>/dev/null; then
        python=$candidate
        break
    fi
done
[ -n "$python" ] || fail "no Python 3.10 or newer found"

make_venv() {
    rm -rf .venv
    "$python" -m venv .venv >/dev/null 2>&1 && .venv/bin/python -m pip --version >/dev/null 2>&1
}

if ! .venv/bin/python -m pip --version >/dev/null 2>&1; then
    version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    make_venv || {
        { apt_install "python$version-venv" || apt_install python3-venv; } && make_venv
    } || fail "$python cannot make a virtual environment: python3-venv is missing"
fi

echo 'setup: installing nonexp and what it needs into .venv'
.venv/bin/python -m pip install --disable-pip-version-check --quiet -e '.[test]' || {
    echo 'setup: pip could not install nonexp and what it needs (see above)' >&2
    exit 1
}

# ---------------------------------------------------------------------- libraries

# Dr.Jit's wheels for Linux need libatomic.so.1; minimal systems lack it.
has_libatomic() {
    [ "$(uname)" != Linux ] || .venv/bin/python -c 'import ctypes; ctypes.CDLL("libatomic.so.1")' 2>/dev/null
}

has_libatomic || { apt_install libatomic1 && has_libatomic; } ||
    fail "libatomic.so.1 is missing, which Dr.Jit needs"

# Prints what is wrong with LLVM, nothing if it works.
llvm_problem() {
    .venv/bin/python -c 'from nonexp.system import machine; print(machine.inspect().problem or "")'
}

problem=$(llvm_problem)
if [ -n "$problem" ]; then
    for package in libllvm19 libllvm20 libllvm18 libllvm21 libllvm22; do
        apt_install "$package" || continue
        break
    done
    problem=$(llvm_problem)
fi
if [ -n "$problem" ]; then
    if .venv/bin/python -c 'from nonexp.system import machine as m; exit(not m.inspect().gpu)'; then
        printf 'setup: %s\n' "$problem" "rendering will use the GPU; the tests need LLVM" >&2
    else
        fail "$problem"
    fi
fi
