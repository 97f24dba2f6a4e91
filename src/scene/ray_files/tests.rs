//! What the readers and writers promise, on files that are put together byte by byte.

use std::io::Cursor;

use super::*;

/// A TM-25 file in parts, so that a test can change one.
#[derive(Clone)]
pub(super) struct Tm25Parts {
    pub flux: [f32; 2],
    pub num_rays: u64,
    pub identifier: i32,
    pub single: f32,
    pub counts: [i32; 3],
    pub flags: [i32; 8],
    pub after: Vec<u8>,
    pub rays: Vec<f32>,
}

impl Tm25Parts {
    pub(super) fn bytes(&self) -> Vec<u8> {
        let mut bytes = b"TM25".to_vec();
        bytes.extend(2013_i32.to_le_bytes());
        bytes.extend(1_i32.to_le_bytes());
        bytes.extend(self.flux.iter().flat_map(|x| x.to_le_bytes()));
        bytes.extend(self.num_rays.to_le_bytes());
        bytes.extend(b"2026-05-12T13:57:44+02:00\0\0\0");
        bytes.extend(0_i32.to_le_bytes());
        bytes.extend(self.identifier.to_le_bytes());
        bytes.extend([self.single, 400.0, 700.0].iter().flat_map(|x| x.to_le_bytes()));
        bytes.extend(self.counts.iter().flat_map(|x| x.to_le_bytes()));
        bytes.resize(256, 0);
        bytes.extend(self.flags.iter().flat_map(|x| x.to_le_bytes()));
        for text in ["Lamp", "Maker & Söhne", "", "", "", "", "350 mA", "", ""] {
            let end = bytes.len() + 4000;
            bytes.extend(text.chars().flat_map(|c| u32::from(c).to_le_bytes()));
            bytes.resize(end, 0);
        }
        assert_eq!(bytes.len(), 36288);
        bytes.extend(&self.after);
        bytes.extend(self.rays.iter().flat_map(|x| x.to_le_bytes()));
        bytes
    }
}

/// Three rays with radiant flux alone.
pub(super) fn tm25() -> Tm25Parts {
    Tm25Parts {
        flux: [f32::NAN, 3.5],
        num_rays: 3,
        identifier: 0,
        single: f32::NAN,
        counts: [0, 0, 0],
        flags: [1, 1, 1, 0, 0, 0, 0, 0],
        after: Vec::new(),
        rays: vec![
            1.0, 2.0, 3.0, 0.0, 0.0, 1.0, 0.5, //
            -1.0, -2.0, -3.0, 0.6, 0.0, 0.8, 1.0, //
            0.0, 0.25, 0.0, 0.0, -0.6, -0.8, 2.0,
        ],
    }
}

fn table(num_pairs: i32) -> Vec<u8> {
    let mut bytes = num_pairs.to_le_bytes().to_vec();
    for pair in 0..num_pairs {
        bytes.extend((400.0 + 2.0 * pair as f32).to_le_bytes());
        bytes.extend((pair as f32 / 100.0).to_le_bytes());
    }
    bytes.resize(bytes.len().next_multiple_of(32), 0);
    bytes
}

/// A binary source file of two rays: unit of length, format of rays, kind of flux, and the rays.
pub(super) fn zemax(unit: i32, ray_format: i32, flux_type: i32, rays: &[f32]) -> Vec<u8> {
    let mut bytes = 1010_i32.to_le_bytes().to_vec();
    bytes.extend(2_u32.to_le_bytes());
    bytes.extend(b"Two rays");
    bytes.resize(108, 0);
    // Flux of source and set, wavelength, four angles.
    bytes.extend([9.0_f32, 3.0, 0.45, 0.0, 90.0, 0.0, 360.0].iter().flat_map(|x| x.to_le_bytes()));
    bytes.extend(unit.to_le_bytes());
    let placement = [0.0_f32, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0];
    bytes.extend(placement.iter().flat_map(|x| x.to_le_bytes()));
    bytes.extend([ray_format, flux_type, 0, 0].iter().flat_map(|x| x.to_le_bytes()));
    assert_eq!(bytes.len(), 208);
    bytes.extend(rays.iter().flat_map(|x| x.to_le_bytes()));
    bytes
}

pub(super) const FLUX_ONLY: [f32; 14] =
    [1.0, 2.0, 3.0, 0.0, 0.0, 1.0, 1.0, 4.0, 5.0, 6.0, 0.6, 0.0, 0.8, 2.0];
pub(super) const SPECTRAL: [f32; 16] =
    [1.0, 2.0, 3.0, 0.0, 0.0, 1.0, 1.0, 0.5, 4.0, 5.0, 6.0, 0.6, 0.0, 0.8, 2.0, 0.625];
pub(super) const TEXT: &str =
    "3 4\r\n1 2 3 0 0 1 0.5 0.55\r\n\r\n-1\t-2 -3e0 0.6 0 0.8 1 0.6\r\n 0 0 0 0 -1 0 2 0.65\r\n\x1a";

/// An archive as NumPy writes it, but for the order of its members.
pub(super) fn npz(columns: &[(&str, &str, Vec<u8>)]) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let stored = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    for (name, header, data) in columns {
        archive.start_file(format!("{name}.npy"), stored).unwrap();
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(data);
        std::io::Write::write_all(&mut archive, &bytes).unwrap();
    }
    archive.finish().unwrap().into_inner()
}

/// Two rays in the columns of a database.
pub(super) fn npz_columns() -> Vec<(&'static str, &'static str, Vec<u8>)> {
    const HEADER: &str = "{'descr': '<f8', 'fortran_order': False, 'shape': (2,), }          \n";
    let numbers = |numbers: [f64; 2]| numbers.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    vec![
        ("x", HEADER, numbers([1.0, 4.0])),
        ("y", HEADER, numbers([2.0, 5.0])),
        ("z", HEADER, numbers([3.0, 6.0])),
        ("L", HEADER, numbers([0.0, 0.6])),
        ("M", HEADER, numbers([0.0, 0.0])),
        ("N", HEADER, numbers([1.0, 0.8])),
        ("flux", HEADER, numbers([1.0, 2.0])),
        ("wavelength", HEADER, numbers([0.5, 0.625])),
        ("ray_id", "{'descr': '<u8', 'fortran_order': False, 'shape': (2,), }\n", numbers([0.0, 0.0])),
    ]
}

fn open(bytes: &[u8], name: &str) -> Result<RayFile<Cursor<Vec<u8>>>> {
    RayFile::of(Cursor::new(bytes.to_vec()), name)
}

fn all<R: Read + Seek>(file: &mut RayFile<R>) -> Result<Vec<Ray>> {
    let mut rays = Vec::new();
    file.for_each(|index, ray| {
        assert_eq!(index, rays.len() as u64);
        rays.push(*ray);
        Ok::<(), Error>(())
    })?;
    Ok(rays)
}

fn ray(position: [f64; 3], direction: [f64; 3], flux: f64, wavelength: Option<f64>) -> Ray {
    Ray { position, direction, flux, wavelength }
}

/// Equal to within single precision.
fn assert_near(rays: &[Ray], expected: &[Ray]) {
    assert_eq!(rays.len(), expected.len());
    for (ray, expected) in rays.iter().zip(expected) {
        let numbers = |ray: &Ray| {
            let all = ray.position.into_iter().chain(ray.direction).chain([ray.flux]);
            all.chain(ray.wavelength).collect::<Vec<f64>>()
        };
        let (numbers, expected_numbers) = (numbers(ray), numbers(expected));
        let is_near = |(a, b): (&f64, &f64)| (a - b).abs() <= 1e-7 * b.abs().max(1e-3);
        assert_eq!(numbers.len(), expected_numbers.len());
        assert!(numbers.iter().zip(&expected_numbers).all(is_near), "{ray:?}\n{expected:?}");
        let [l, m, n] = ray.direction;
        assert!((l * l + m * m + n * n - 1.0).abs() < 1e-15);
    }
}

/// The message of a file that must be refused, when it is opened or read.
fn message(bytes: &[u8], name: &str) -> String {
    let read = open(bytes, name).and_then(|mut file| {
        let sum = file.sum_flux()?;
        file.compare_total(sum)
    });
    read.expect_err("the file is refused").to_string()
}

#[test]
fn a_tm25_file_is_read() {
    let mut file = open(&tm25().bytes(), "lamp.tm25ray").unwrap();
    let header = file.header();
    assert_eq!((header.format, header.num_rays, header.unit), (Format::Tm25, 3, LengthUnit::MILLIMETRE));
    assert_eq!((header.flux_kind, header.total_flux), (Some(FluxKind::Radiant), Some(3.5)));
    assert_eq!(header.wavelengths, Wavelengths::None);
    assert_eq!(header.description, "Lamp Maker & Söhne");
    assert!(header.remarks.is_empty());
    let expected = [
        ray([1.0, 2.0, 3.0], [0.0, 0.0, 1.0], 0.5, None),
        ray([-1.0, -2.0, -3.0], [0.6, 0.0, 0.8], 1.0, None),
        ray([0.0, 0.25, 0.0], [0.0, -0.6, -0.8], 2.0, None),
    ];
    assert_near(&all(&mut file).unwrap(), &expected);
    assert_eq!(file.sum_flux().unwrap(), 3.5);
    assert_eq!(file.compare_total(3.5).unwrap(), None);
}

#[test]
fn columns_that_are_not_used_are_stepped_over_and_named() {
    let mut parts = tm25();
    parts.identifier = 2;
    parts.flags = [1, 1, 1, 1, 1, 1, 1, 0];
    parts.counts = [0, 2, 64];
    for name in ["phase", "field"] {
        let end = parts.after.len() + 512;
        parts.after.extend(name.chars().flat_map(|c| u32::from(c).to_le_bytes()));
        parts.after.resize(end, 0);
    }
    parts.after.resize(2 * 512 + 64, b'!');
    parts.num_rays = 2;
    // Position, direction, W, nm, lm, three Stokes parameters, ellipse, X, Z, phase, field.
    let one =
        [1.0, 2.0, 3.0, 0.0, 0.0, 1.0, 1.5, 550.0, 99.0, 7.0, 7.0, 7.0, 8.0, 8.0, 8.0, 5.0, 6.0, -1.0, -2.0];
    let mut two = one;
    (two[6], two[7]) = (2.0, 450.0);
    parts.rays = [one, two].concat();
    let mut file = open(&parts.bytes(), "lamp.tm25ray").unwrap();
    let expected = [
        ray([1.0, 2.0, 3.0], [0.0, 0.0, 1.0], 1.5, Some(0.55)),
        ray([1.0, 2.0, 3.0], [0.0, 0.0, 1.0], 2.0, Some(0.45)),
    ];
    assert_near(&all(&mut file).unwrap(), &expected);
    assert_eq!(file.header().wavelengths, Wavelengths::PerRay);
    let remarks = file.header().remarks.join("\n");
    for name in ["luminous flux", "Stokes", "tristimulus", "`phase`, `field`"] {
        assert!(remarks.contains(name), "{remarks}");
    }
}

#[test]
fn a_table_is_the_spectrum_of_all_rays_and_is_padded() {
    for (num_pairs, start) in [(51, 36704), (76, 36928), (86, 36992)] {
        let mut parts = tm25();
        (parts.identifier, parts.counts[0], parts.after) = (3, 1, table(num_pairs));
        let bytes = parts.bytes();
        // Where the rays of three files of ams OSRAM begin.
        assert_eq!(bytes.len(), start + 3 * 28);
        let mut file = open(&bytes, "lamp.tm25ray").unwrap();
        assert_eq!(all(&mut file).unwrap().len(), 3);
        let Wavelengths::Spectrum(pairs) = &file.header().wavelengths else { unreachable!() };
        assert_eq!(pairs.len(), num_pairs as usize);
        assert_eq!(pairs[0], (0.4, 0.0));
        assert!((pairs[50].0 - 0.5).abs() < 1e-12 && (pairs[50].1 - 0.5).abs() < 1e-7);
    }
}

#[test]
fn luminous_flux_is_taken_where_there_is_no_other() {
    let mut parts = tm25();
    (parts.identifier, parts.single) = (1, 555.0);
    parts.flags = [1, 1, 0, 0, 1, 0, 0, 0];
    parts.flux = [3.5, 0.0];
    let file = open(&parts.bytes(), "lamp.tm25ray").unwrap();
    assert_eq!((file.header().flux_kind, file.header().total_flux), (Some(FluxKind::Luminous), Some(3.5)));
    let Wavelengths::One(wavelength) = file.header().wavelengths else { unreachable!() };
    assert!((wavelength - 0.555).abs() < 1e-12);
    // The flux then stands behind the wavelength.
    (parts.identifier, parts.num_rays) = (2, 1);
    parts.flags[3] = 1;
    parts.rays = vec![0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 500.0, 3.5];
    let mut file = open(&parts.bytes(), "lamp.tm25ray").unwrap();
    assert_near(&all(&mut file).unwrap(), &[ray([0.0; 3], [0.0, 0.0, 1.0], 3.5, Some(0.5))]);
}

#[test]
fn tm25_files_that_contradict_themselves_are_refused() {
    type Change = fn(&mut Tm25Parts);
    let changes: [(Change, &str); 24] = [
        (|parts| parts.num_rays = 4, "4 rays of 28 bytes end at byte 36400, and the file has 36372 bytes"),
        (|parts| parts.num_rays = 2, "a ray file ends with its last ray"),
        (|parts| parts.num_rays = u64::MAX, "rays of 28 bytes"),
        (|parts| parts.rays.truncate(20), "cut off"),
        (|parts| parts.rays[8] = f32::NAN, "ray 1, byte 36316: the position"),
        (|parts| parts.rays[8] = f32::INFINITY, "ray 1, byte 36316: the position"),
        (|parts| parts.rays[10] = f32::NAN, "ray 1, byte 36316: the direction"),
        (|parts| parts.rays[12] = 0.81, "has length 1.008"),
        (|parts| parts.rays[13] = -1.0, "ray 1, byte 36316: the flux is -1"),
        (|parts| parts.rays[13] = f32::NAN, "the flux is NaN"),
        (|parts| parts.flux[1] = 3.6, "states 3.59999990463"),
        (|parts| parts.flux[1] = -1.0, "byte 16: the total flux is -1"),
        (|parts| parts.flags[0] = 0, "the flag of the position is 0"),
        (|parts| parts.flags[3] = 2, "byte 268: the flag of the wavelength is 2"),
        (|parts| parts.flags[2] = 0, "neither radiant nor luminous flux"),
        (|parts| parts.identifier = 1, "identifier is 1, and a wavelength of NaN nm"),
        (|parts| parts.identifier = 2, "without a wavelength of each ray"),
        (|parts| parts.identifier = 3, "identifier is 3, with 0 spectral tables"),
        (|parts| parts.identifier = 4, "rays choose among several spectra"),
        (|parts| parts.identifier = -1, "the spectral identifier is -1"),
        (|parts| parts.counts[0] = -1, "the number of spectral tables is -1"),
        (|parts| (parts.counts[0], parts.after) = (1, (-5_i32).to_le_bytes().to_vec()), "has -5 pairs"),
        (
            |parts| (parts.counts[0], parts.after) = (1, 60_000_i32.to_le_bytes().to_vec()),
            "table 1 ends at byte",
        ),
        (|parts| parts.counts[1] = i32::MAX, "the number of additional columns is 2147483647"),
    ];
    for (change, expected) in changes {
        let mut parts = tm25();
        change(&mut parts);
        let message = message(&parts.bytes(), "lamp.tm25ray");
        assert!(message.contains(expected), "{expected}: {message}");
    }
    let mut bytes = tm25().bytes();
    bytes[4] = 0;
    assert!(message(&bytes, "lamp.tm25ray").contains("the version is 1792"));
    assert!(message(&bytes[..36_287], "lamp.tm25ray").contains("ends within its header"));
    assert!(message(b"TM26", "lamp.tm25ray").contains("does not begin with `TM25`"));
}

#[test]
fn a_directions_length_is_made_1_within_a_thousandth() {
    for (scale, is_taken) in [(0.9985, false), (0.9995, true), (1.0005, true), (1.0015, false)] {
        let mut parts = tm25();
        parts.rays[5] = scale;
        let rays = open(&parts.bytes(), "lamp.tm25ray").and_then(|mut file| all(&mut file));
        assert_eq!(rays.is_ok(), is_taken);
        assert!(rays.is_err() || rays.unwrap()[0].direction == [0.0, 0.0, 1.0]);
    }
}

#[test]
fn a_total_that_differs_by_more_than_roundings_is_refused() {
    let mut parts = tm25();
    parts.flux[1] = 3.5_f32.next_up();
    let file = open(&parts.bytes(), "lamp.tm25ray").unwrap();
    assert_eq!(file.compare_total(3.5).unwrap(), None);
    let error = file.compare_total(3.5001).unwrap_err();
    assert!(error.problem.contains("3.5001 W") && error.problem.contains("3.500000238418579 W"), "{error}");
    parts.flux[1] = 0.0;
    assert_eq!(open(&parts.bytes(), "").unwrap().header().total_flux, None);
}

#[test]
fn a_zemax_binary_file_is_read() {
    let units = [(0, 1000.0), (1, 25.4), (2, 10.0), (3, 304.8), (4, 1.0)];
    for (unit, millimetres) in units {
        let mut file = open(&zemax(unit, 0, 1, &FLUX_ONLY), "lamp.dat").unwrap();
        let header = file.header().clone();
        assert_eq!((header.format, header.num_rays), (Format::ZemaxBinary, 2));
        assert_eq!((header.unit.millimetres, header.flux_kind), (millimetres, Some(FluxKind::Luminous)));
        assert_eq!((header.total_flux, header.description.as_str()), (Some(3.0), "Two rays"));
        assert_eq!(header.wavelengths, Wavelengths::One(f64::from(0.45_f32)));
        let at = |position: [f64; 3]| position.map(|x| x * millimetres);
        let expected = [
            ray(at([1.0, 2.0, 3.0]), [0.0, 0.0, 1.0], 1.0, Some(0.45)),
            ray(at([4.0, 5.0, 6.0]), [0.6, 0.0, 0.8], 2.0, Some(0.45)),
        ];
        assert_near(&all(&mut file).unwrap(), &expected);
        assert_eq!(file.sum_flux().unwrap(), 3.0);
    }
    let mut file = open(&zemax(4, 2, 0, &SPECTRAL), "lamp.sdf").unwrap();
    assert_eq!(file.header().wavelengths, Wavelengths::PerRay);
    let wavelengths: Vec<_> = all(&mut file).unwrap().iter().map(|ray| ray.wavelength).collect();
    assert_eq!(wavelengths, [Some(0.5), Some(0.625)]);
    // A header that states another flux is no obstacle, since OpticStudio does not read it.
    let remark = file.compare_total(4.0).unwrap().unwrap();
    assert!(remark.contains("it states 3 W") && remark.contains("4 W"), "{remark}");
}

#[test]
fn zemax_binary_files_that_contradict_themselves_are_refused() {
    let bytes = zemax(4, 0, 0, &FLUX_ONLY);
    let with = |at: usize, word: i32| {
        let mut bytes = bytes.clone();
        bytes[at..at + 4].copy_from_slice(&word.to_le_bytes());
        message(&bytes, "lamp.dat")
    };
    for (message, expected) in [
        (with(4, -1), "4294967295 rays of 28 bytes end at byte"),
        (with(4, 1), "a ray file ends with its last ray"),
        (with(136, 5), "byte 136: the unit of length is 5"),
        (with(136, -1), "the unit of length is -1"),
        (with(192, 1), "byte 192: the format of rays is 1"),
        (with(192, 2), "rays of 32 bytes"),
        (with(196, 2), "byte 196: the kind of flux is 2"),
        (with(208 + 28, f32::NAN.to_bits() as i32), "ray 1, byte 236: the position"),
        (message(&bytes[..100], "lamp.dat"), "ends within its header of 208 bytes"),
        (message(&bytes[..263], "lamp.dat"), "cut off"),
        (message(&[0, 0, 3, 0xf2], "lamp.dat"), "big-endian"),
        (message(&zemax(4, 2, 1, &SPECTRAL), "lamp.sdf"), "the kind of flux is 1"),
    ] {
        assert!(message.contains(expected), "{expected}: {message}");
    }
    let mut spectral = SPECTRAL;
    spectral[15] = 0.0;
    assert!(message(&zemax(4, 2, 0, &spectral), "lamp.sdf").contains("the wavelength is 0 um"));
}

#[test]
fn a_zemax_text_file_is_read() {
    let mut file = open(TEXT.as_bytes(), "lamp.DAT").unwrap();
    assert_eq!((file.header().format, file.header().num_rays), (Format::ZemaxText, 3));
    assert_eq!((file.header().flux_kind, &file.header().wavelengths), (None, &Wavelengths::PerRay));
    let expected = [
        ray([1.0, 2.0, 3.0], [0.0, 0.0, 1.0], 0.5, Some(0.55)),
        ray([-1.0, -2.0, -3.0], [0.6, 0.0, 0.8], 1.0, Some(0.6)),
        ray([0.0; 3], [0.0, -1.0, 0.0], 2.0, Some(0.65)),
    ];
    assert_near(&all(&mut file).unwrap(), &expected);
    // As a program pads the first line to the width of a ray.
    let padded = "1.0 1.0 0.0 0.0 0.0 0.0 0.0\n1 2 3 0 0 1 7";
    let mut file = open(padded.as_bytes(), "lamp.txt").unwrap();
    assert_near(&all(&mut file).unwrap(), &[ray([25.4, 50.8, 76.2], [0.0, 0.0, 1.0], 7.0, None)]);
}

#[test]
fn zemax_text_files_that_contradict_themselves_are_refused() {
    let long = format!("1 4\n{}", "1 ".repeat(4000));
    for (text, expected) in [
        ("", "the file is empty"),
        ("\n \n", "the file is empty"),
        ("rays\n", "line 1: this is no header"),
        ("3\n", "this is no header"),
        ("1 4 7\n1 2 3 0 0 1 1\n", "this is no header"),
        ("-1 4\n1 2 3 0 0 1 1\n", "-1 rays cannot be"),
        ("1.5 4\n1 2 3 0 0 1 1\n", "1.5 rays cannot be"),
        ("NaN 4\n1 2 3 0 0 1 1\n", "NaN rays cannot be"),
        ("1e15 4\n1 2 3 0 0 1 1\n", "1000000000000000 rays cannot be, in a file of 21 bytes"),
        ("1 5\n1 2 3 0 0 1 1\n", "line 1: the unit of length is 5"),
        ("2 4\n1 2 3 0 0 1 1\n          ", "the file ends after 1 of 2 rays"),
        ("1 4\n1 2 3 0 0 1 1\n1 2 3 0 0 1 1\n", "line 3: more lines follow the 1 rays"),
        ("1 4\n1 2 3 0 0 1\n", "ray 0, line 2: \"1 2 3 0 0 1\" is not 7 numbers"),
        ("1 4\n1 2 3 0 0 1 x\n", "is not 7 numbers"),
        ("2 4\n1 2 3 0 0 1 1 .5\n1 2 3 0 0 1 1\n", "ray 1, line 3: \"1 2 3 0 0 1 1\" is not 8 numbers"),
        ("1 4\n1 2 nan 0 0 1 1\n", "ray 0, line 2: the position"),
        ("1 0\n1 2 1e308 0 0 1 1\n", "the position"),
        ("1 4\n1 2 3 0 0 2 1\n", "has length 2"),
        ("1 4\n1 2 3 0 0 1 -1\n", "the flux is -1"),
        ("1 4\n1 2 3 0 0 1 1 inf\n", "the wavelength is inf um"),
        (&long, "line 2: the line has 4096 bytes or more"),
    ] {
        let message = message(text.as_bytes(), "lamp.txt");
        assert!(message.contains(expected), "{expected}: {message}");
    }
    let late = [b"1 4\n".as_slice(), &b" ".repeat(64), b"\xff\n"].concat();
    assert!(message(&late, "lamp.dat").contains("line 2: the line is no text"));
    assert!(message(b"1 4\n\xff", "lamp.dat").contains("its format is unknown"));
    assert!(message(TEXT.as_bytes(), "lamp.bin").contains("its format is unknown"));
}

#[test]
fn columns_of_a_ray_database_are_read() {
    let mut file = open(&npz(&npz_columns()), "det.npz").unwrap();
    assert_eq!((file.header().format, file.header().num_rays), (Format::Npz, 2));
    assert_eq!(file.header().flux_kind, Some(FluxKind::Radiant));
    let expected = [
        ray([1.0, 2.0, 3.0], [0.0, 0.0, 1.0], 1.0, Some(0.5)),
        ray([4.0, 5.0, 6.0], [0.6, 0.0, 0.8], 2.0, Some(0.625)),
    ];
    assert_eq!(all(&mut file).unwrap(), expected);
    let without: Vec<_> = npz_columns().into_iter().filter(|(name, ..)| *name != "wavelength").collect();
    let mut file = open(&npz(&without), "det.npz").unwrap();
    assert_eq!(file.header().wavelengths, Wavelengths::None);
    assert_eq!(all(&mut file).unwrap()[1].wavelength, None);
}

#[test]
fn archives_that_are_no_ray_database_are_refused() {
    let with = |index: usize, header: &'static str, num_bytes: usize| {
        let mut columns = npz_columns();
        (columns[index].1, columns[index].2) = (header, vec![0; num_bytes]);
        message(&npz(&columns), "det.npz")
    };
    let bytes = npz(&npz_columns());
    let mut missing = npz_columns();
    missing.remove(6);
    let mut flipped = bytes.clone();
    let first_number = bytes.windows(6).position(|six| six == b"\x93NUMPY").unwrap() + 82;
    flipped[first_number] ^= 1;
    for (message, expected) in [
        (message(&flipped, "det.npz"), "x: the column's bytes do not have the archive's check sum"),
        (
            with(6, "{'descr': '<f8', 'fortran_order': False, 'shape': (3,), }", 24),
            "has 3 numbers, and `x` has 2",
        ),
        (with(6, "{'descr': '<f8', 'fortran_order': False, 'shape': (2,), }", 24), "do not fill"),
        (with(6, "{'descr': '>f8', 'fortran_order': False, 'shape': (2,), }", 16), "little-endian f8"),
        (
            with(6, "{'descr': '<f8', 'fortran_order': False, 'shape': (2, 1), }", 16),
            "shape of the array is not (n,)",
        ),
        (with(6, "{'descr': '<f8', 'shape': (18446744073709551615,), }", 16), "do not fill"),
        (with(6, "{'descr': '<f8', 'shape': (-2,), }", 16), "shape of the array is not (n,)"),
        (message(&npz(&missing), "det.npz"), "there is no column `flux`"),
        (message(&bytes[..bytes.len() / 2], "det.npz"), "the archive"),
    ] {
        assert!(message.contains(expected), "{expected}: {message}");
    }
}

/// Rays without a pattern, of many magnitudes.
fn many(num_rays: u64, has_wavelengths: bool) -> Vec<Ray> {
    (0..num_rays)
        .map(|index| {
            let x = index as f64;
            let (sine, cosine) = x.sin_cos();
            let wavelength = has_wavelengths.then_some(0.4 + 0.3 * sine * sine);
            ray([x, -x / 3.0, 1e-3 * x], [0.6 * sine, 0.6 * cosine, 0.8], 1e-6 * (1.0 + x), wavelength)
        })
        .collect()
}

#[test]
fn what_is_written_as_tm25_comes_back() {
    let spectrum = vec![(0.4, 0.0), (0.55, 1.0), (0.7, 0.25)];
    for wavelengths in
        [Wavelengths::None, Wavelengths::One(0.55), Wavelengths::PerRay, Wavelengths::Spectrum(spectrum)]
    {
        for flux_kind in [FluxKind::Radiant, FluxKind::Luminous] {
            if wavelengths == Wavelengths::PerRay && flux_kind == FluxKind::Luminous {
                continue;
            }
            let mut rays = many(1000, wavelengths == Wavelengths::PerRay);
            let labels = Tm25Labels {
                flux_kind,
                wavelengths: wavelengths.clone(),
                name: "lens & lamp µ".into(),
                software: "nsq-gpu".into(),
                date: String::new(),
            };
            let mut writer = Tm25Writer::new(Cursor::new(Vec::new()), labels).unwrap();
            rays.iter().try_for_each(|ray| writer.push(ray)).unwrap();
            let bytes = writer.finish().unwrap().into_inner();
            let mut file = open(&bytes, "out.tm25ray").unwrap();
            assert_eq!(file.header().description, "lens & lamp µ");
            assert_eq!(file.header().flux_kind, Some(flux_kind));
            match (&file.header().wavelengths, &wavelengths) {
                (Wavelengths::One(read), Wavelengths::One(written)) => {
                    assert!((read / written - 1.0).abs() < 1e-7)
                }
                (Wavelengths::Spectrum(read), Wavelengths::Spectrum(written)) => {
                    assert_eq!(read.len(), written.len());
                    assert!(read.iter().zip(written).all(|(a, b)| (a.0 - b.0).abs() < 1e-7 && a.1 == b.1));
                }
                (read, written) => assert_eq!(read, written),
            }
            if wavelengths == Wavelengths::One(0.55) {
                rays.iter_mut().for_each(|ray| ray.wavelength = Some(0.55));
            }
            assert_near(&all(&mut file).unwrap(), &rays);
            let sum = file.sum_flux().unwrap();
            assert_eq!(file.compare_total(sum).unwrap(), None);
        }
    }
}

#[test]
fn rays_that_tm25_cannot_hold_are_refused() {
    let labels = Tm25Labels {
        flux_kind: FluxKind::Radiant,
        wavelengths: Wavelengths::PerRay,
        name: String::new(),
        software: String::new(),
        date: String::new(),
    };
    let luminous = Tm25Labels { flux_kind: FluxKind::Luminous, ..labels.clone() };
    let error = Tm25Writer::new(Cursor::new(Vec::new()), luminous).unwrap_err();
    assert!(error.problem.contains("cannot have wavelengths"));
    let mut writer = Tm25Writer::new(Cursor::new(Vec::new()), labels).unwrap();
    writer.push(&many(1, true)[0]).unwrap();
    let error = writer.push(&many(1, false)[0]).unwrap_err();
    assert_eq!((error.place.as_str(), error.problem.as_str()), ("ray 1", "it has no wavelength"));
    let large = ray([1e39, 0.0, 0.0], [0.0, 0.0, 1.0], 1.0, Some(0.5));
    assert!(writer.push(&large).unwrap_err().problem.contains("single precision"));
    assert_eq!(open(writer.finish().unwrap().get_ref(), "").unwrap().header().num_rays, 1);
}

/// The columns that a trace writes of rays.
fn columns_of(rays: &[Ray]) -> Vec<u8> {
    let header =
        |count: usize| format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({count},), }}\n");
    let column = |name, number: &dyn Fn(&Ray) -> f64| {
        let mut numbers: Vec<f64> = rays.iter().map(number).collect();
        // A database without rays has one flux and one wavelength of 0.
        if rays.is_empty() && matches!(name, "flux" | "wavelength") {
            numbers.push(0.0);
        }
        let bytes = numbers.iter().flat_map(|number| number.to_le_bytes()).collect::<Vec<u8>>();
        (name, header(numbers.len()), bytes)
    };
    let mut columns = vec![
        column("x", &|ray| ray.position[0]),
        column("y", &|ray| ray.position[1]),
        column("z", &|ray| ray.position[2]),
        column("L", &|ray| ray.direction[0]),
        column("M", &|ray| ray.direction[1]),
        column("N", &|ray| ray.direction[2]),
        column("flux", &|ray| ray.flux),
    ];
    if rays.iter().all(|ray| ray.wavelength.is_some()) {
        columns.push(column("wavelength", &|ray| ray.wavelength.unwrap()));
    }
    npz(&columns
        .iter()
        .map(|(name, header, bytes)| (*name, header.as_str(), bytes.clone()))
        .collect::<Vec<_>>())
}

#[test]
fn columns_of_a_ray_database_come_back_to_the_bit() {
    for has_wavelengths in [false, true] {
        for num_rays in [0, 1, 20_000] {
            let rays = many(num_rays, has_wavelengths);
            let mut file = open(&columns_of(&rays), "out.npz").unwrap();
            let read = all(&mut file).unwrap();
            // Directions are made to have length 1 once more.
            assert_near(&read, &rays);
            let same = |(a, b): (&Ray, &Ray)| {
                (a.position, a.flux, a.wavelength) == (b.position, b.flux, b.wavelength)
            };
            assert!(read.iter().zip(&rays).all(same));
        }
    }
}

#[test]
fn any_range_is_read_at_any_time() {
    const NUM_RAYS: u64 = 10_000;
    let rays = many(NUM_RAYS, true);
    let mut text = format!("{NUM_RAYS} 4\n");
    for (index, Ray { position: [x, y, z], direction: [l, m, n], flux, wavelength }) in
        rays.iter().enumerate()
    {
        let blank = if index % 1000 == 0 { "\n" } else { "" };
        text += &format!("{blank}{x} {y} {z} {l} {m} {n} {flux} {}\n", wavelength.unwrap());
    }
    let labels = Tm25Labels {
        flux_kind: FluxKind::Radiant,
        wavelengths: Wavelengths::PerRay,
        name: String::new(),
        software: String::new(),
        date: String::new(),
    };
    let mut writer = Tm25Writer::new(Cursor::new(Vec::new()), labels).unwrap();
    rays.iter().try_for_each(|ray| writer.push(ray)).unwrap();
    let tm25 = writer.finish().unwrap().into_inner();
    for (bytes, name) in
        [(text.into_bytes(), "lamp.txt"), (columns_of(&rays), "lamp.npz"), (tm25, "lamp.tm25ray")]
    {
        let mut file = open(&bytes, name).unwrap();
        let mut read = Vec::new();
        for range in
            [9_000..9_001, 4095..4097, 0..1, 8192..10_000, 0..10_000, 5000..5000, 10_000..10_000, 4096..8193]
        {
            file.read(range.clone(), &mut read).unwrap();
            assert_near(&read, &rays[range.start as usize..range.end as usize]);
        }
        let error = file.read(9_999..10_001, &mut read).unwrap_err();
        assert_eq!(error.problem, "the file has 10000 rays, and 9999..10001 were asked for");
        assert_eq!(file.sha256().unwrap(), format!("{:x}", Sha256::digest(&bytes)));
        assert_eq!(file.num_bytes(), bytes.len() as u64);
    }
}

#[test]
fn files_on_disk_are_opened() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lamp.tm25ray");
    std::fs::write(&path, tm25().bytes()).unwrap();
    assert_eq!(RayFile::open(&path).unwrap().sum_flux().unwrap(), 3.5);
    for path in [folder.path(), &folder.path().join("none.dat")] {
        assert_eq!(RayFile::open(path).unwrap_err().problem, "there is no such file");
    }
}
