// Media at a wavelength. The host composes Medium and medium_of: the index n, and the absorption 4 pi k / lambda
// [1/mm].

fn medium_at(medium: u32, wavelength: u32) -> Medium {
    // Where the medium is a constant, the bound shows the compiler that no other medium's rows are read.
    let column = min(wavelength, NUM_WAVELENGTHS - 1u);
    return medium_of(medium * NUM_WAVELENGTHS + column);
}
