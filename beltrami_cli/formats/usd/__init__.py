"""USD layers and USDZ packages, which usd-core reads and writes in a process of its own.

That process imports `stage`, `reading`, `geometry`, `materials` and `editing`, and nothing else imports usd-core.
`layers` sends it requests, and `contents` are its answers.
"""
