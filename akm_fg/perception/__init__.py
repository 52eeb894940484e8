"""From RGB-D frames to tracked points in space, sorted into moving and static."""
