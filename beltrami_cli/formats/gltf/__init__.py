"""glTF 2.0, text or binary.

`container` takes a file apart into chunks and JSON, whose objects are `entries`; `json_text` changes its text, and
`references` finds what names what in it. Bytes come from `uris` and `buffers`, which `meshopt` decodes, numbers from
`accessors`, and triangles from `primitives`, which `draco` decodes. `nodes`, `materials` and `images` say where
meshes stand and which textures they show. All of these are read into `vertex_colours`, or by `parts` into a
`textured_surface` or a `textured_mesh`.

`edit` collects the changes that `new_attributes` and `new_images` make, and `output` makes files of them.
`fingerprint` is for comparisons, `writer` for conversions.
"""
