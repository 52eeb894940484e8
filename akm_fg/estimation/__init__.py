"""From tracks to a posterior over joint kind, joint frame and states."""
