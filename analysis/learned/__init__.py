"""Scores of a run's video by models trained by others: ViCLIP (does it show the prompt?) and a VQA physics score.

Each record's scores stand beside it in `run.learned.json`; the table reads them through `sidecar`, without torch.
"""
