"""The parts of the campaign of mutants: changed lines, the tests that reach them, processes that try them."""
