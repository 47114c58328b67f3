"""What real detectors write, in one form."""
