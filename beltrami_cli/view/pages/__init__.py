"""Pages for browsers: templates, scripts, and the Python that puts them and their data together."""
