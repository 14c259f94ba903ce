"""A page with a model before and after."""
