"""A camera and its detector's clock, registered against the truth that AIS and a scene give."""
