//! What makes enums of a list of kinds.

/// Makes of `Enum: Trait, functions Functions: Wgsl;` and a list of `Name(file::Type) by Function = WGSL, ...;`
/// - the enum `Enum` of all kinds, which dereferences to what the kind's file says of it as a `dyn Trait`, and
/// - the enum `Functions` of what the shaders call. A kind may have several functions, of which it picks one. The position
///   of a function in the list is its code in the shaders.
///
/// Kinds are copied, unless the list begins with what is derived for them.
macro_rules! kinds {
    ($enum:ident: $($list:tt)+) => {
        kinds! { #[derive(Debug, Clone, Copy, PartialEq)] $enum: $($list)+ }
    };
    (
        #[$derived:meta] $enum:ident: $trait:ident, functions $functions:ident: $wgsl:ident;
        $(
            $(#[doc = $doc:literal])+
            $(#[cfg($cfg:meta)])?
            $name:ident($file:ident::$type:ident)
                by $($(#[cfg($function_cfg:meta)])? $function:ident = $text:ident),+;
        )+
    ) => {
        #[doc = concat!("A kind of the list; what it can do stands in [`", stringify!($trait), "`].")]
        #[$derived]
        pub enum $enum {
            $($(#[doc = $doc])+ $(#[cfg($cfg)])? $name($file::$type),)+
        }

        impl std::ops::Deref for $enum {
            type Target = dyn $trait;

            fn deref(&self) -> &Self::Target {
                match self {
                    $($(#[cfg($cfg)])? $enum::$name(kind) => kind,)+
                }
            }
        }

        /// Functions of the shaders, by their codes.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum $functions {
            $($(
                $(#[cfg($function_cfg)])?
                #[doc = concat!("[`", stringify!($file), "::", stringify!($text), "`]")]
                $function,
            )+)+
        }

        impl $functions {
            /// All of them, in the order of their codes.
            pub const ALL: &[$functions] =
                &[$($($(#[cfg($function_cfg)])? $functions::$function,)+)+];

            /// What the shaders have of it.
            pub fn wgsl(self) -> &'static $wgsl {
                match self {
                    $($($(#[cfg($function_cfg)])? $functions::$function => &$file::$text,)+)+
                }
            }
        }
    };
}
pub(super) use kinds;
