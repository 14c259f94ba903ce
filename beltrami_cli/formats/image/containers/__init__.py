"""What image files hold besides pixels, a module for each format: chunks, segments, tags and headers.

A module has these functions, as far as its format needs them (`formats/image/metadata.py` calls them):

- `metadata_names(data)` names the pieces of metadata in a file; the values say whether OpenImageIO reads the piece.
- `carried_over(source, encoded)` gives a new file all that its source holds besides pixels.
- `exif(data)` and `with_exif(encoded, exif_data)` read and replace EXIF data.

Files that they cannot follow raise one of `metadata.DAMAGED`.
"""
