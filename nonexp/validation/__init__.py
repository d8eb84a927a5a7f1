"""Published numbers, and those of independent programs, beside ours.

``run``     all studies, their rows and verdicts
``study``   quantities, results, how many samples they take
``slabs``   light reflected and transmitted by slabs
``walks``   collisions in an infinite medium, first collisions in slabs

Each folder is a study: author, year and place of what it compares with, the numbers in
``numbers.csv`` with their errors and where they stand, and a function ``measure``.
"""
