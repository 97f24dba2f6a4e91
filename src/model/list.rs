//! What makes enums of a list of kinds.

/// Makes three enums of a list of `Name(file::Type) by Function = WGSL, ...;`:
/// - the enum of all kinds, which dereferences to what the kind's file says of it as a `dyn` of the trait,
/// - the enum of the functions that the shaders call. A kind may have several functions, of which it picks one, or none,
///   if it picks the function of another kind. The code of a function in the shaders is its position in the list, unless
///   `Function(code)` gives another one.
/// - the enum `Written` of what scene files have, by the key `type`: each file's `Written`.
///
/// The documentation of a kind is also its description in the schema of scene files.
macro_rules! kinds {
    (
        $(#[derive($($derive:ident),+)])?
        $enum:ident: $trait:ident,
        functions $functions:ident: $wgsl:ident,
        $(#[doc = $written_doc:literal])+
        written $schema:literal: $entry:ident;
        $(
            $(#[doc = $doc:literal])+
            $(#[cfg($cfg:meta)])?
            $name:ident($file:ident::$type:ident)
                $(by $(
                    $(#[cfg($function_cfg:meta)])? $function:ident $(($code:literal))? = $text:ident
                ),+)?;
        )+
        $(unwritten {
            $(
                $(#[doc = $of_doc:literal])+
                $of_name:ident($of_file:ident::$of_type:ident) by $($of_function:ident $(($of_code:literal))? = $of_text:ident),+;
            )+
        })?
    ) => {
        #[doc = concat!("A kind of the list; what it can do stands in [`", stringify!($trait), "`].")]
        #[derive(Debug, Clone, PartialEq $(, $($derive),+)?)]
        pub enum $enum {
            $($(#[doc = $doc])+ $(#[cfg($cfg)])? $name($file::$type),)+
            $($($(#[doc = $of_doc])+ $of_name($of_file::$of_type),)+)?
        }

        impl std::ops::Deref for $enum {
            type Target = dyn $trait;

            fn deref(&self) -> &Self::Target {
                match self {
                    $($(#[cfg($cfg)])? $enum::$name(kind) => kind,)+
                    $($($enum::$of_name(kind) => kind,)+)?
                }
            }
        }

        /// Functions of the shaders, by their codes.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum $functions {
            $($($(
                $(#[cfg($function_cfg)])?
                #[doc = concat!("[`", stringify!($file), "::", stringify!($text), "`]")]
                $function $(= $code)?,
            )+)?)+
            $($($(
                #[doc = concat!("[`", stringify!($of_file), "::", stringify!($of_text), "`]")]
                $of_function $(= $of_code)?,
            )+)+)?
        }

        impl $functions {
            /// All of them, in the order of the list.
            pub const ALL: &[$functions] =
                &[$($($($(#[cfg($function_cfg)])? $functions::$function,)+)?)+ $($($($functions::$of_function,)+)+)?];

            /// Those that occur, in the order of their codes, without repetition.
            pub fn distinct(functions: impl Iterator<Item = Self>) -> Vec<Self> {
                functions.collect::<std::collections::BTreeSet<_>>().into_iter().collect()
            }

            /// The code in the shaders.
            pub fn code(self) -> u32 {
                self as u32
            }

            /// What the shaders have of it.
            pub fn wgsl(self) -> &'static $wgsl {
                match self {
                    $($($($(#[cfg($function_cfg)])? $functions::$function => &$file::$text,)+)?)+
                    $($($($functions::$of_function => &$of_file::$of_text,)+)+)?
                }
            }
        }

        $(#[doc = $written_doc])+
        #[derive(Debug, Clone, PartialEq, serde::Deserialize, schemars::JsonSchema)]
        #[serde(rename_all = "snake_case")]
        #[schemars(tag = "type", rename = $schema)]
        pub enum Written {
            $($(#[doc = $doc])+ $(#[cfg($cfg)])? $name($file::Written),)+
        }

        impl Written {
            fn entry(&self) -> &(dyn $entry + 'static) {
                match self {
                    $($(#[cfg($cfg)])? Written::$name(written) => written,)+
                }
            }
        }
    };
}
pub(super) use kinds;
