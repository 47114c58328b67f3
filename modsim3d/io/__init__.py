"""Files within budgets, put in place whole by one writer at a time; worker processes, plug-ins, shipped files."""
