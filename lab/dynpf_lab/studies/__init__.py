"""The experiments of the source documents: many seeded trials, summarized with the uncertainty that so many leave."""
