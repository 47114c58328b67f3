"""The sources of truth side by side: rendered against analytic, and the idealised rectangle rule against rendered."""
