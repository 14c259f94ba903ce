"""Pictures and pages of models."""
