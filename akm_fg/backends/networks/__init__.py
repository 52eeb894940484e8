"""What the backends with networks share: pictures in, arrays out, and what is said when absent."""
