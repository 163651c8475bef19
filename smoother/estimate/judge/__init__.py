"""What results are compared and judged by."""
