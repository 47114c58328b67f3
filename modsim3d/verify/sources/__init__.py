"""The sources of truth side by side: rendered against analytic, and the thesis's rectangle rule against rendered."""
