"""SymPy: virtual joints and terms, the elastic chain, and the Programs that every emitter walks."""
