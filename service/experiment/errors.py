"""Errors of an experiment.

::

    AmbError (sim.errors)
    └── ExperimentError
        ├── ExperimentFileError   a file breaks the contract of experiment files; names file, dataset and remedy
        │     └── ExperimentSizeError   it holds, or states to hold, more than there is memory
        ├── JournalError          the journal of an interrupted campaign does not belong to this rig and plan
        └── CampaignError         the campaign cannot go on; what was measured is kept
"""

from sim.errors import AmbError


class ExperimentError(AmbError):
    """Base of every error of an experiment."""


class ExperimentFileError(ExperimentError):
    """An experiment file cannot be read: one line that names the file, the dataset and what is wrong with it."""


class JournalError(ExperimentError):
    """A journal that lies in the output folder cannot be continued with this rig and plan."""


class CampaignError(ExperimentError):
    """The campaign cannot start or go on; what was measured so far is on disk."""


class ExperimentSizeError(ExperimentFileError):
    """An experiment file holds, or states to hold, more than the memory there is."""
