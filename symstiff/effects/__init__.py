"""The catalogue of effects: one small file an effect, all of one shape."""

from symstiff.effects.base import Effect, EffectParameter, Realisation
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import catalogue, find

__all__ = ["Effect", "EffectInstance", "EffectParameter", "Realisation", "catalogue", "find"]
