"""The mechanisms of the documents: platforms on chains, cranks and carriages, whose loops are closed by equations of constraint."""
