"""Writing the files of a run: all or none.

- `output` is one result: OUTPUT with its sidecar files, a report, a preview; `sidecars` says which names are free.
- `file_set` is all files of a run, and `journal` writes them aside and moves them into place, each by `placing`.
- `locks` keep runs apart, `file_rights` keeps the permissions of replaced files.
- `shared_files` warns of other models that show a replaced file.
"""
