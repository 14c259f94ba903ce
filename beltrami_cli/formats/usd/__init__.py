"""USD layers and USDZ packages, which usd-core reads and writes in a process of its own.

That is `process`, with `stage`, `reading`, `geometry`, `mesh`, `materials`, `shown_images` and `editing`; nothing else
imports usd-core. `layers` sends it requests, and `contents` has the types of these and of the answers.
"""
