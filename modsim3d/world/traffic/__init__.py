"""Traffic that is drawn from the seed: routes, speeds, times, types and sizes of vessels."""
