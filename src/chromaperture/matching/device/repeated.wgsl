// Mirrored at the border, whose pixel is repeated ("symmetric" of NumPy's pad).
fn repeated(at: i32, count: u32) -> u32 {
    let end = i32(count);
    var place = at;
    while (place < 0i || place >= end) { place = select(2i * end - 1i - place, -1i - place, place < 0i); }
    return u32(place);
}
