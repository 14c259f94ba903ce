"""Files that a model names.

`model_folder` finds them, and refuses what leaves the folder of the model; `new_files` names those of an output.
`tile_names` are the names of tile sets (UDIM).
"""
