"""File formats: a file is opened as a document that keeps its bytes, and only its colours are patched.

`registry` recognises a file, or refuses it by what `unread` knows. `loading` imports the class of its `document` (of
images `image_document`), `changes` are patched into it, and `output_format` chooses another format to write.
`full_scale` and `colours` say what stored numbers mean, and `fingerprint` is for comparisons. `files`, `sidecars`,
`meshes` and `image` serve the formats, each of which has a folder of its own.
"""
