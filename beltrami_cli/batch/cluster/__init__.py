"""Many machines: files and pieces of surfaces on the workers of a Dask scheduler. Nothing else knows of Dask."""
