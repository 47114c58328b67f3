"""Simulated voyages whose camera, clock and detector are known: what is learned of them is compared with it."""
