"""The discrepancy workflow: noise, lack of fit, place, name, verdict, growth of the model, proof.

Its rooms in the order in which data flows, each importing what is to its left alone: ``problem`` and ``reasons``;
``noise``, ``laws``, ``statistics``; ``search`` and ``bridge``; ``apart``; ``findings``; then ``examine`` (on arrays),
``climb``, ``conclusion`` and ``workflow`` (on a table).
"""
