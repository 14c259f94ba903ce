"""One file or folder for each thing that can be done with files; errors are raised, and nothing is printed.

- Jobs that write a file with new colours and nothing else changed: `smooth`, `level`, `noise`. Each gives a filter
  to `recolour`, which takes a `file_job` from INPUT to `result_files`; `smoothing` is the filter of the first two.
- Jobs that write a new file: `bake`, and `unwrapped` for `smooth --unwrap`; both take their texture from `new_texture`.
- Jobs that describe or compare files: `inspect`, `kernel`, `check`, `compare`.
- Jobs that begin and end with arrays: `arrays`.
- Shared by all: `job` is how a job is done, `opening` reads INPUT, `writing` writes all files of a run or none, and
  `progress` and `settings` are records that the command line knows, too.
"""
