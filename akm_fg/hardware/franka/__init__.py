"""A Franka arm over its own control interface (`franky-control`, which wraps libfranka)."""
