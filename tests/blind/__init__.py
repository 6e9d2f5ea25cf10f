"""The blind benchmark: hidden effects in simulated measurements, diagnosed from the table alone.

``python -m tests.blind --n 200 --jobs 2`` runs it at full size. Generator (``generate``, ``stories``) and
workflow share no formula: the data come from the nonlinear simulator with shapes of its own. The truth
stays with the generator.
"""
