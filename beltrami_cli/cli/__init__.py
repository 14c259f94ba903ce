"""The command line: click and rich live here and nowhere else.

- `main` runs a command, and maps exceptions to exit codes; `interruption` and `streams` prepare the process.
- `commands` has a module for each command, `registry` lists them, and `command` declares them and formats their help.
- `parameter_options` makes options from records, and records from options; `options` are shared by commands.
- `option_names` finds options by their names, also in the environment; `configuration` reads the file with options.
- `outputs` runs a job and writes all its files; `batch_items` makes the items of a batch.
- `console` prints messages, tables and progress, and `phrases` makes parts of messages.
- `documentation` reads the pages of the documentation, and `manual` writes manual pages.
"""
