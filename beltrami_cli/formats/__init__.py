"""File formats: a file is opened as a document that keeps its bytes, and only its colours are patched.

`registry` recognises a file, `loading` imports the class of its `document`, `changes` are patched into it, and
`output_format` chooses another format to write. `files`, `sidecars`, `meshes` and `image` serve the formats, each of
which has a folder of its own.
"""
