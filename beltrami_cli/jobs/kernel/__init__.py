"""The kernel of one sample in a file: `places` finds the sample, `drawing` shows where its kernel is heavy."""
