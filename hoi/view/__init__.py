"""Runs in the browser, from their records alone; `python -m hoi.view --help`. Only `hoi.view.viewer` and what it alone
uses (`nodes`, `panel`) import viser; the rest is what `hoi.export.page` draws too."""
