//! The registry of lens models: one line each.

use std::fmt;
use std::str::FromStr;

use crate::{CameraModel, Error};

/// An action on a lens model whose type is known: dispatch happens once, outside the loops.
pub trait ModelVisitor {
    /// What the action returns.
    type Output;

    /// Acts on `model`.
    fn visit<M: CameraModel>(self, model: M) -> Self::Output;
}

macro_rules! camera_models {
    ($($variant:ident => $model:ty),* $(,)?) => {
        /// A lens model of the registry.
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub enum Model {
            $(#[doc = concat!("See [`", stringify!($model), "`].")] $variant($model),)*
        }

        impl Model {
            /// Returns the names of all registered models.
            pub fn names() -> Vec<&'static str> {
                vec![$(<$model as CameraModel>::NAME),*]
            }

            /// Returns the name of this model, without its configuration.
            pub fn name(&self) -> &'static str {
                match self { $(Model::$variant(_) => <$model as CameraModel>::NAME,)* }
            }

            /// Returns the configuration, as it is written after the name, if the model has one.
            pub fn configuration(&self) -> Option<String> {
                match self { $(Model::$variant(model) => model.configuration(),)* }
            }

            /// Returns the model with what its configuration leaves open chosen so that the model covers
            /// `directions` in the camera frame.
            pub fn completed(&self, directions: &[[f64; 3]]) -> Self {
                match self { $(Model::$variant(model) => Model::$variant(model.completed(directions)),)* }
            }

            /// Calls the visitor with the model's own type.
            #[inline(always)]
            pub fn visit<V: ModelVisitor>(self, visitor: V) -> V::Output {
                match self { $(Model::$variant(model) => visitor.visit(model),)* }
            }
        }

        $(impl From<$model> for Model {
            fn from(model: $model) -> Self {
                Self::$variant(model)
            }
        })*

        impl FromStr for Model {
            type Err = Error;

            fn from_str(text: &str) -> Result<Self, Error> {
                let (name, configuration) = match text.split_once(':') {
                    Some((name, configuration)) => (name, Some(configuration)),
                    None => (text, None),
                };
                $(if name == <$model as CameraModel>::NAME {
                    return Ok(Model::$variant(configured(configuration)?));
                })*
                Err(Error::UnknownModel { name: name.to_owned(), known: Model::names() })
            }
        }

        #[cfg(test)]
        mod conformance {
            $(
                #[expect(non_snake_case, reason = "the tests of a model bear its name")]
                mod $variant {
                    crate::conformance::conformance_tests!($model);
                }
            )*
        }
    };
}

camera_models! {
    Pinhole => crate::pinhole::Pinhole,
    OpenCv4 => crate::opencv::OpenCv<4>,
    OpenCv5 => crate::opencv::OpenCv<5>,
    OpenCv8 => crate::opencv::OpenCv<8>,
    OpenCv12 => crate::opencv::OpenCv<12>,
    OpenCv14 => crate::opencv::OpenCv<14>,
    KannalaBrandt4 => crate::kannala_brandt4::KannalaBrandt4,
    DoubleSphere => crate::double_sphere::DoubleSphere,
    Eucm => crate::eucm::Eucm,
    Mei => crate::mei::Mei,
    Division => crate::division::Division,
    Stereographic => crate::stereographic::Stereographic,
    LonLat => crate::geographic::LonLat,
    LatLon => crate::geographic::LatLon,
    Cahvor => crate::cahvor::Cahvor,
    Cahvore => crate::cahvor::Cahvore,
    Splined2 => crate::splined::Splined<2>,
    Splined3 => crate::splined::Splined<3>,
}

/// The name, and after a colon the configuration, as `from_str` reads it.
impl fmt::Display for Model {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())?;
        match self.configuration() {
            Some(configuration) => write!(f, ":{configuration}"),
            None => Ok(()),
        }
    }
}

/// Returns the model of a configuration; without one, the model's usual.
fn configured<M: CameraModel + Default>(configuration: Option<&str>) -> Result<M, Error> {
    let Some(text) = configuration else { return Ok(M::default()) };
    M::configured(text).ok_or_else(|| Error::BadConfiguration {
        model: M::NAME,
        found: text.to_owned(),
        need: M::CONFIGURATION.unwrap_or("none"),
    })
}
