"""Where vessels are and how they move: pose sources, waves, and the inertial unit that measures it."""
