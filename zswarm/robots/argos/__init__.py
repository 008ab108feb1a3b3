"""Controllers as the texts that controllers of ARGoS read: NEAT's genomes, AutoMoDe's machines."""
