"""The catalogue of effects: one small file an effect, all of one shape."""

from symstiff.effects.base import Effect, EffectInstance, EffectParameter, Realisation, catalogue, find

__all__ = ["Effect", "EffectInstance", "EffectParameter", "Realisation", "catalogue", "find"]
