// Where the correlations of all layers are: of primary pairs (pairs, bands, samples, computed), then of secondary pairs
// (pairs, bands, samples, of_all_pairs), which have the first layers only.

fn correlations_of(pair: u32, band: u32, samples: u32, sample: u32) -> u32 {
    let place = ((pair * bands + band) * samples + sample) * computed;
    if (pair < primary_pairs) { return place; }
    return primary_pairs * bands * samples * computed + (((pair - primary_pairs) * bands + band) * samples + sample) * of_all_pairs;
}
