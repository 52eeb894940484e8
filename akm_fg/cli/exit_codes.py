"""What the exit code of a command says."""

DONE = 0
GOAL_NOT_REACHED = 1
UNDECIDED = 1  # of `fit`: no kind of joint is sure enough to be named
BAD_INPUT = 2
INTERRUPTED = 130  # 128 + SIGINT
READER_LEFT = 141  # 128 + SIGPIPE: of a pipe that standard output goes to
