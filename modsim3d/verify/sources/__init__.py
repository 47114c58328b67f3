"""The sources of truth side by side: rendered against drawn and analytic, and the idealised rectangle rule."""
