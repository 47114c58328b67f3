"""Ground truth: what each camera sees of each vessel, from pixels and from geometry."""
