// What media are at a wavelength. The host composes Medium and medium_of: n, and the absorption 4 pi k / lambda [1/mm].

fn medium_at(medium: u32, wavelength: u32) -> Medium {
    return medium_of(medium * NUM_WAVELENGTHS + wavelength);
}
