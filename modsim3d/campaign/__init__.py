"""Campaigns: a plan of many runs, their scores, the verdicts on requirements, and the runs that went worst."""
