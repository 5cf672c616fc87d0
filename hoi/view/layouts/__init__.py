"""How viewers that know nothing of hoi show a record: a layout for Foxglove, a recording with a blueprint for Rerun."""
