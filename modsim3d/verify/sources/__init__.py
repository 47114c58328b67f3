"""The sources of truth side by side: rendered against drawn, analytic, and the thesis's rectangle rule."""
