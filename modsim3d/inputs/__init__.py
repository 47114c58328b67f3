"""Reading what users give: strict YAML and JSON, budgets, plug-ins, and what ships with the package."""
