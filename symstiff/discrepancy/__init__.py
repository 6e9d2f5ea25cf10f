"""The discrepancy workflow: noise, lack of fit, place, name, verdict, growth of the model, proof."""
