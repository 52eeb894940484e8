"""Sources of information: each file is one, and says what it contributes."""
