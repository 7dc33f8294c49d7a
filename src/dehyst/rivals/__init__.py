"""What others do: rival models and identifications behind the common interface, to compare with on equal terms."""
