"""What the documentation is made with: ``make docs`` runs these modules."""
