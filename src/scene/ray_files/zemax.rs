//! Binary source files of Zemax OpticStudio, `.DAT` and `.SDF`, read.
//!
//! Sources of the layout: the help of OpticStudio, "Source File", sections "Binary Source File format" and "Text Source
//! File format". Also Zemax's article "Converting a binary Source File into ASCII".
//!
//! A header of 208 bytes, then rays of seven f32 (flux only) or eight (spectral color). The program that
//! defines the format uses four fields of the header: rays, unit of length, format of rays, kind of flux.
//! So its other fields are reported, and bind nothing.

use std::io::{Read, Seek};

use super::ray::{Error, FluxKind, Format, Header, LengthUnit, Result, Wavelengths};
use super::records::{Records, f32_at, head, i32_at};

/// First word of a file: the version of the format.
pub(super) const VERSIONS: [i32; 2] = [1010, 8_675_309];
const HEADER: usize = 208;
const DESCRIPTION: std::ops::Range<usize> = 8..108;
const RAY_SET_FLUX: usize = 112;
const WAVELENGTH: usize = 116;
const UNIT: usize = 136;
/// Three numbers each: translation and rotation.
const PLACEMENT: std::ops::Range<usize> = 140..164;
const RAY_FORMAT: usize = 192;
const FLUX_TYPE: usize = 196;

pub(super) fn open(reader: &mut (impl Read + Seek), length: u64) -> Result<(Header, Records)> {
    let bytes = head(reader, HEADER, length)?;
    // Up to 4e9 rays: the count has no sign.
    let num_rays = u64::from(i32_at(&bytes, 4) as u32);
    let unit = i32_at(&bytes, UNIT);
    let unit = u64::try_from(unit).ok().and_then(LengthUnit::of_zemax).ok_or_else(|| {
        let remedy = "0 is for m, 1 for in, 2 for cm, 3 for ft, 4 for mm";
        Error::at(UNIT as u64, format!("the unit of length is {unit}"), remedy)
    })?;
    let is_spectral = match i32_at(&bytes, RAY_FORMAT) {
        0 => false,
        2 => true,
        other => {
            let remedy = "0 is for flux only, 2 for spectral color; export the rays in one of these";
            return Err(Error::at(RAY_FORMAT as u64, format!("the format of rays is {other}"), remedy));
        }
    };
    let flux_kind = match (i32_at(&bytes, FLUX_TYPE), is_spectral) {
        (0, _) => FluxKind::Radiant,
        (1, false) => FluxKind::Luminous,
        (other, _) => {
            let remedy = "0 is for W, and 1 for lm, which goes with the format flux only";
            return Err(Error::at(FLUX_TYPE as u64, format!("the kind of flux is {other}"), remedy));
        }
    };
    let mut remarks = Vec::new();
    let single = f64::from(f32_at(&bytes, WAVELENGTH));
    let wavelengths = if is_spectral {
        Wavelengths::PerRay
    } else if single.is_finite() && single > 0.0 {
        remarks
            .push(format!("all rays have the header's wavelength, {single} um, which OpticStudio ignores"));
        Wavelengths::One(single)
    } else {
        Wavelengths::None
    };
    if bytes[PLACEMENT].iter().any(|&byte| byte != 0) {
        remarks
            .push("the header's translation and rotation are not applied; OpticStudio ignores them".into());
    }
    let records = Records {
        start: HEADER as u64,
        num_items: if is_spectral { 8 } else { 7 },
        millimetres: unit.millimetres,
        flux: 6,
        wavelength: is_spectral.then_some((7, 1.0)),
        single: (wavelengths == Wavelengths::One(single)).then_some(single),
    };
    records.check_length(num_rays, length)?;
    let total = f64::from(f32_at(&bytes, RAY_SET_FLUX));
    let text = bytes[DESCRIPTION].iter().take_while(|&&byte| byte != 0);
    let header = Header {
        format: Format::ZemaxBinary,
        num_rays,
        unit,
        flux_kind: Some(flux_kind),
        total_flux: (total.is_finite() && total > 0.0).then_some(total),
        wavelengths,
        description: text.map(|&byte| char::from(byte)).collect::<String>().trim().into(),
        remarks,
    };
    Ok((header, records))
}
