"""What else may stand behind an explanation: the log, a bent signal, another plane, a lag that is not there."""
