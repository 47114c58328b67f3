"""Input and output: strict YAML and JSON, files put in place whole, one writer at a time, processes, plug-ins."""
