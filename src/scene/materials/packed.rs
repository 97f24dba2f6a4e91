//! Reads `catalog.bin`, whose layout stands in `python/tools/make_catalog.py`. Every step returns `None` on data that
//! does not follow it.

use std::collections::HashMap;
use std::sync::{Arc, OnceLock};

use crate::scene::materials::catalog::{Catalog, Name, Omission, Omitted};
use crate::scene::materials::catalog_bytes::Reader;
use crate::scene::materials::catalog_entry::CatalogEntry;

/// Unpacks a catalog, but for the numbers of its entries.
pub(super) fn unpack(bytes: &'static [u8]) -> Option<Catalog> {
    let mut reader = Reader { bytes };
    let references = reader.list(|reader| Some(Arc::from(reader.text()?)))?;
    let entries = reader.list(|reader| entry(reader, &references))?;
    let omitted = reader.list(omitted)?;
    let num_targets = entries.len() + omitted.len();
    let names = reader.list(|reader| name(reader, num_targets))?;
    reader.bytes.is_empty().then(|| index(entries, omitted, names))
}

fn index(entries: Vec<CatalogEntry>, omitted: Vec<Omitted>, names: Vec<Name>) -> Catalog {
    let paths = entries.iter().map(|entry| &entry.path).chain(omitted.iter().map(|entry| &entry.path));
    let by_path: HashMap<_, _> =
        paths.enumerate().map(|(target, path)| (path.to_lowercase(), target)).collect();
    let by_name =
        names.iter().enumerate().map(|(index, name)| (name.spelling.to_lowercase(), index)).collect();
    Catalog { entries, omitted, names, by_name, by_path }
}

fn entry(reader: &mut Reader<'static>, references: &[Arc<str>]) -> Option<CatalogEntry> {
    let (path, title, page) = (reader.text()?, reader.text()?, reader.text()?);
    let reference = references.get(reader.index()?)?.clone();
    Some(CatalogEntry {
        path,
        title,
        page,
        reference,
        packed: reader.packed_optics()?,
        optics: OnceLock::new(),
    })
}

fn omitted(reader: &mut Reader<'_>) -> Option<Omitted> {
    let path = reader.text()?;
    let reason = match reader.unsigned()? {
        0 => Omission::TooLarge,
        1 => Omission::NoIndex,
        2 => Omission::Refused,
        _ => return None,
    };
    Some(Omitted { path, reason })
}

fn name(reader: &mut Reader<'_>, num_targets: usize) -> Option<Name> {
    let spelling = reader.text()?;
    let target = reader.index()?;
    let exact = reader.unsigned()? == 1;
    let others = reader.list(Reader::index)?;
    let known = others.iter().chain([&target]).all(|&target| target < num_targets);
    known.then_some(Name { spelling, target, exact, others })
}
