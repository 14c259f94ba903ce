"""Pictures and pages of models and images.

- `render` draws files, `before_after` is the picture of `smooth --preview`; both draw the views of `drawing`.
- `report` compares two files on a page, `sweep` shows many trials on a `sheet`; `pages` renders all pages.
- `live` is the view in the browser that smooths while parameters are changed.
- `light` makes linear light and display values of stored colours; `settings` are the parameters of pictures.
- `noise_in_words` and `parameter_tables` describe reports for messages and pages.
"""
