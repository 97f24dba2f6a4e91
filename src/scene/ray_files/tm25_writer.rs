//! Writes IES TM-25-13 ray files, `.tm25ray`, in the layout of [`super::tm25`].

use std::io::{BufWriter, Seek, SeekFrom, Write};

use super::ray::{Error, FluxKind, Ray, Result, Wavelengths};
use super::sum::Sum;
use super::tm25::{
    ALIGNMENT, FLAGS, HEADER, LUMINOUS_FLUX, MAGIC, NANOMETRE, NUM_RAYS, NUM_TABLES, RADIANT_FLUX,
    SINGLE_WAVELENGTH, SPECTRAL_IDENTIFIER, TEXT_BYTES, TEXTS, VERSION,
};

const DATE: std::ops::Range<usize> = 28..56;
const MIN_WAVELENGTH: usize = 68;
const MAX_WAVELENGTH: usize = 72;

/// What a TM-25 file shall say of its rays.
#[derive(Debug, Clone, PartialEq)]
pub struct Tm25Labels {
    /// What the flux of a ray measures.
    pub flux_kind: FluxKind,
    /// Wavelengths. With `PerRay` each ray must have one.
    pub wavelengths: Wavelengths,
    /// Name of the light source.
    pub name: String,
    /// The program that wrote the file.
    pub software: String,
    /// When it was written, in ISO 8601. Equal results are equal files only if this is left empty.
    pub date: String,
}

/// Writes a TM-25 file ray by ray. The number of rays and their flux need not be known before.
#[derive(Debug)]
pub struct Tm25Writer<W: Write + Seek> {
    writer: BufWriter<W>,
    labels: Tm25Labels,
    num_rays: u64,
    flux: Sum,
    /// Shortest and longest wavelength \[nm\].
    range: [f32; 2],
}

impl<W: Write + Seek> Tm25Writer<W> {
    /// Starts a file.
    ///
    /// # Errors
    /// If the standard has no such file, or it cannot be written.
    pub fn new(writer: W, labels: Tm25Labels) -> Result<Self> {
        if labels.wavelengths == Wavelengths::PerRay && labels.flux_kind == FluxKind::Luminous {
            let problem = "rays with luminous flux cannot have wavelengths in TM-25";
            return Err(Error::new("the header", problem, "write their radiant flux, or no wavelengths"));
        }
        let range = match &labels.wavelengths {
            Wavelengths::Spectrum(pairs) => [pairs.first(), pairs.last()]
                .map(|pair| pair.map_or(f32::NAN, |&(wavelength, _)| (wavelength / NANOMETRE) as f32)),
            Wavelengths::None | Wavelengths::One(_) | Wavelengths::PerRay => [f32::NAN; 2],
        };
        let writer = BufWriter::with_capacity(1 << 16, writer);
        let mut file = Tm25Writer { writer, labels, num_rays: 0, flux: Sum::default(), range };
        let header = file.header();
        file.write(&header)?;
        Ok(file)
    }

    /// Adds a ray.
    ///
    /// # Errors
    /// If its numbers are beyond f32, if it lacks the wavelength that the labels promise, or if the file cannot
    /// be written.
    pub fn push(&mut self, ray: &Ray) -> Result<()> {
        let refused =
            |problem: &str, remedy: &str| Err(Error::new(format!("ray {}", self.num_rays), problem, remedy));
        let mut items = [0.0_f32; 8];
        let numbers = ray.position.iter().chain(&ray.direction).chain([&ray.flux]);
        items.iter_mut().zip(numbers).for_each(|(item, &number)| *item = number as f32);
        let mut num_items = 7;
        if self.labels.wavelengths == Wavelengths::PerRay {
            let Some(wavelength) = ray.wavelength else {
                return refused("it has no wavelength", "all rays of the file must have one");
            };
            items[7] = (wavelength / NANOMETRE) as f32;
            num_items = 8;
        }
        if !items.iter().all(|item| item.is_finite()) {
            return refused("its numbers are beyond single precision", "write it as npz");
        }
        if num_items == 8 {
            // Of NaN and a number, both take the number.
            self.range = [self.range[0].min(items[7]), self.range[1].max(items[7])];
        }
        let bytes: Vec<u8> = items[..num_items].iter().flat_map(|item| item.to_le_bytes()).collect();
        self.write(&bytes)?;
        self.num_rays += 1;
        self.flux.add(f64::from(items[6]));
        Ok(())
    }

    /// Ends the file: its header gets the number of rays and their flux.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn finish(mut self) -> Result<W> {
        let header = self.header();
        let sought = self.writer.seek(SeekFrom::Start(0));
        sought.map_err(|error| Error::io("the header", &error))?;
        self.write(&header)?;
        self.writer.into_inner().map_err(|error| Error::io("the header", error.error()))
    }

    fn write(&mut self, bytes: &[u8]) -> Result<()> {
        let written = self.writer.write_all(bytes);
        written.map_err(|error| Error::io(format!("ray {}", self.num_rays), &error))
    }

    /// All that stands before the rays; its length never changes.
    fn header(&self) -> Vec<u8> {
        let Tm25Labels { flux_kind, wavelengths, name, software, date } = &self.labels;
        let mut bytes = vec![0; HEADER];
        let mut put = |at: usize, word: [u8; 4]| bytes[at..at + 4].copy_from_slice(&word);
        let is_radiant = *flux_kind == FluxKind::Radiant;
        let (identifier, single) = match wavelengths {
            Wavelengths::None => (0_i32, f32::NAN),
            Wavelengths::One(wavelength) => (1, (wavelength / NANOMETRE) as f32),
            Wavelengths::PerRay => (2, f32::NAN),
            Wavelengths::Spectrum(_) => (3, f32::NAN),
        };
        put(0, *MAGIC);
        put(4, VERSION.to_le_bytes());
        let total = self.flux.value() as f32;
        put(LUMINOUS_FLUX, if is_radiant { f32::NAN } else { total }.to_le_bytes());
        put(RADIANT_FLUX, if is_radiant { total } else { f32::NAN }.to_le_bytes());
        put(NUM_RAYS, (self.num_rays as u32).to_le_bytes());
        put(NUM_RAYS + 4, ((self.num_rays >> 32) as u32).to_le_bytes());
        put(SPECTRAL_IDENTIFIER, identifier.to_le_bytes());
        put(SINGLE_WAVELENGTH, single.to_le_bytes());
        put(MIN_WAVELENGTH, self.range[0].to_le_bytes());
        put(MAX_WAVELENGTH, self.range[1].to_le_bytes());
        put(NUM_TABLES, i32::from(identifier == 3).to_le_bytes());
        let flags = [true, true, is_radiant, identifier == 2, !is_radiant, false, false, false];
        for (index, flag) in flags.into_iter().enumerate() {
            put(FLAGS + 4 * index, i32::from(flag).to_le_bytes());
        }
        let letters = date.bytes().filter(u8::is_ascii);
        bytes[DATE].iter_mut().zip(letters).for_each(|(byte, letter)| *byte = letter);
        // The last of a text's 1000 characters stays 0.
        for (index, text) in [(0, name), (4, software)] {
            let letters = text.chars().take(TEXT_BYTES / 4 - 1).flat_map(|c| u32::from(c).to_le_bytes());
            bytes[TEXTS + index * TEXT_BYTES..]
                .iter_mut()
                .zip(letters)
                .for_each(|(byte, letter)| *byte = letter);
        }
        if let Wavelengths::Spectrum(pairs) = wavelengths {
            bytes.extend((pairs.len() as i32).to_le_bytes());
            for &(wavelength, weight) in pairs {
                bytes.extend(((wavelength / NANOMETRE) as f32).to_le_bytes());
                bytes.extend((weight as f32).to_le_bytes());
            }
            bytes.resize(HEADER + (bytes.len() - HEADER).next_multiple_of(ALIGNMENT as usize), 0);
        }
        bytes
    }
}
