"""Computer-assisted proofs of gaits in ball arithmetic, from equations of their own (docs/proofs.md)."""
