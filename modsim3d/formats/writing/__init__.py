"""A run in other programs' formats: a module a format, entered in `registry.FORMATS`."""
