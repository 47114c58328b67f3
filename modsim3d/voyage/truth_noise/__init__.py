"""How well truth that is made from AIS is known, and what of that is in the learned errors of boxes."""
