"""Fit models to a measured transmittance, and print the medium of the best as XML.

python examples/fit_table.py [TABLE.csv]
"""

import sys
from pathlib import Path

from nonexp import fitting

table = sys.argv[1] if len(sys.argv) > 1 else Path(__file__).with_name("measured.csv")
distance, ff, sigma = fitting.read_table(table)
names = ("exponential", "gamma", "erlang", "hard_rod", "power")
fits, refused = fitting.compare(names, distance, ff, sigma=sigma, sigma_t="fit")
for fit in fits:
    print(f"{fit.name:12} rms residual {fit.residual:.4f}, AIC - best {fit.aic - fits[0].aic:.1f}")
for name, reason in refused.items():
    print(f"{name}: {reason}")
print(fits[0])
print(fits[0].to_xml())
