"""Pages for browsers: templates, and the libraries that they bring with them."""
