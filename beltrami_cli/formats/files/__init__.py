"""Files of any kind, which are not trusted.

`access` says what a job may read, and reads it; `paths` opens regular files only. `archives`, `numpy_files` and
`bounded_text` read ZIP, NumPy, JSON and TOML within bounds, and `foreign_library` runs other libraries in processes of
their own. `tokens` finds the words of a text by their offsets, and `edits` replaces words and other bytes.
"""
