"""From measured deflections to parameters: tables, virtual experiments, identification, choice of poses.

Its rooms in the order in which data flows, each importing what is to its left alone: ``tables``; ``fits``; ``rows`` and
``residuals``; ``experiment``; ``doubts``; ``simulation``; ``planning``; then ``identify``, ``plan`` and what they need.
"""
