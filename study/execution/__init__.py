"""Tasks and who does them: this process, local workers, a Dask cluster."""
