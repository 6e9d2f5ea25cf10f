"""From evidence to a verdict: sets of effects, their rivals, where the residual sits, held-out proof."""
