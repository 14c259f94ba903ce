"""Large surfaces in pieces: what each owns and borrows, an iteration on one, and the exchange between iterations.

Who runs the pieces, in turn or on many machines, is of no concern here.
"""
