"""Figures that a paper would print: rates, average precision, and what it is lost to."""
