"""Stage one: find where an unseen, closed object opens, in few pulls, and know when to stop."""
