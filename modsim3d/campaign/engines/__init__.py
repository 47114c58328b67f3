"""Where tasks are worked on: this process, processes on this machine, or a Dask cluster."""
