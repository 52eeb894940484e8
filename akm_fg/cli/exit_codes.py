"""What the exit code of a command says."""

DONE = 0
GOAL_NOT_REACHED = 1
BAD_INPUT = 2
INTERRUPTED = 130
