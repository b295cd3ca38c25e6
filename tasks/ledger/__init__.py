"""The ledger of the paper's claims: each is one small function that computes what it says."""
