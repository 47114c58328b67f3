"""Files and processes: strict YAML and JSON within budgets, files put in place whole, one writer at a time, worker
processes, plug-ins, what ships with the package.
"""
