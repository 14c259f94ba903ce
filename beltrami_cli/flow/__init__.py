"""The Beltrami flow: estimation of the noise, a plan of parameters, iterations of the kernel, and patches.

`estimation`, `plan` and `beltrami_flow` are the three steps, in this order; `manifolds` is their subject.
"""
