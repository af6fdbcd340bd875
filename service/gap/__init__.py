"""The sim-to-real gap: where twin and rig differ, which effect explains it, how far it closes. Pure, no I/O.

How data flow through `diagnose.diagnose`:

1. `observed` (``observed.py``, ``measured/``): sweeps -> `Observation`, mean complex amplitudes and their standard
   deviations; datasheet -> `Nuisance`, the vector of its uncertain values; interference is found in the scatter.
2. `explain_parts` (``explain_parts.py``, ``parts_in_turn.py``): controller, amplifiers and plant in turn, each a
   `Ground` of data and of what the parts before it fixed; once more with half of the second sweep where that is needed.
3. `explain` (``which/search.py``), for one part: fits the plain twin, every single effect, then mixtures by forward
   selection. One fit is a `Problem` (``fitting/fit.py``) and ends as a `Candidate` with its `Fit`.
4. `ranked` (``weighing/ranking.py``): candidates -> `Ranked`, by Laplace evidence; a part's result is an `Explained`.
5. `overall_verdict`: `decide` (``weighing/verdict.py``) judges every part, also on unseen data; ``doubts/`` tests for
   causes that are no effect of the catalogue. The rules are those of docs/decisions/0009.
6. `composed` (``compose.py``): the parts' candidates -> whole twins, for `shrinkage` (closure on unseen data), `locate`
   (``where/``: path, band, channel) and `Proposal` (``next_experiment.py``, ``proposal/``: what to measure next).
7. `Diagnosis` -> `gap_document` (``document.py``): gap.json; `applied` (``apply.py``) adds its effects to a datasheet.

Words used throughout: the *plain twin* (``null``) is the datasheet's rig, its values refitted, without an effect. An
array ``z`` holds weighted residuals, measured minus predicted, of unit variance in real and imaginary part; its axes
are (P points, H harmonics, n axes of the rig). What a twin *leaves* is its residuals. ``theta`` is the nuisance vector.
"""
