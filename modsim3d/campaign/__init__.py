"""Many runs: their plan, the rows of their scores, verdicts on requirements, searches, pages."""
