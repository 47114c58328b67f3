"""How long noise persists, and what each vessel keeps of it."""
