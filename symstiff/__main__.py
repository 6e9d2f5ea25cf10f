"""``python -m symstiff``."""

from symstiff.cli import main

main()
