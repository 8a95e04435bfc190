"""The compiled core ``_core``: collision checks, searches, smoothing and timing.

It is one extension module, built from ``module.cpp`` and one folder for each package that it serves. The proof
has compiled code of its own in ``certify/native``, which shares nothing with this.
"""
