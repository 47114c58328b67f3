"""False positives: how many, how large, where, and how long they last."""
