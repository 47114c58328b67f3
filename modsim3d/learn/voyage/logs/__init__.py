"""Readers of what a detector wrote during a voyage."""
