"""Light transport through non-exponential media.

These are Mitsuba plugins, reached by name through scene files and ``mi.load_dict`` after
``import nonexp``; importing them directly needs a variant.
"""
