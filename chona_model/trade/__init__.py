"""What speed costs: every approximation measured on views that training never saw, and the best settings found."""
