"""What every part uses: errors, checks of values, threads, memory, compilation, storage, clusters."""
