"""Images: every pixel through OpenImageIO, every byte of metadata carried over.

A file becomes a `DecodedImage` in `reading`, by what `file_formats`, `opening`, `channels` and `sample_types` know,
with `reading_notices`; `sizes` are read from its header, and `alpha` is divided out of colours where it is multiplied
in. `writing` makes a file of new pixels: as another format holds them (`conversion`), encoded (`encoding`), with
`metadata`, which `containers` read and write in each format. OpenImageIO does not know `ktx2` and `avif`, which
`extra_codecs` joins. `jpeg_tables` says how a JPEG file codes its pixels.
"""
