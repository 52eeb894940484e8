"""Commands on recordings before a fit."""
