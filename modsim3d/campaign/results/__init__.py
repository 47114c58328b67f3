"""The folder of a campaign: its plan, rows that are done, and the data set at the end."""
