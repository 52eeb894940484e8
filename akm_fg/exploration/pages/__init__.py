"""An exploration on its report's page: belief, attempts, what each stretch told."""
