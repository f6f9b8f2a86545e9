"""The equations of a fit: columns, rows, and the elimination of linear parameters."""
