//! Compilers over naga's modules: f64 as pairs of f32 ([`df64`]), derivatives beside every real ([`jvp`]), and the
//! gradient of a loss ([`transpose`]). A name for a compiler is the one that the field has for what it does.

pub mod df64;
mod function_builder;
pub mod jvp;
pub mod transpose;
