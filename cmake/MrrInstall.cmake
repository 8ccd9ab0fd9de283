# cmake --install: the programs, the libraries with exported targets, headers as they stand in the tree, robots and tools.
get_property(libraries GLOBAL PROPERTY MRR_LIBRARIES)
if(libraries)
  install(TARGETS ${libraries} EXPORT mrrTargets ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR})
  install(EXPORT mrrTargets NAMESPACE mrr:: DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/mrr)
  include(CMakePackageConfigHelpers)
  configure_package_config_file(${PROJECT_SOURCE_DIR}/cmake/mrrConfig.cmake.in ${PROJECT_BINARY_DIR}/mrrConfig.cmake
    INSTALL_DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/mrr)
  write_basic_package_version_file(${PROJECT_BINARY_DIR}/mrrConfigVersion.cmake COMPATIBILITY SameMinorVersion)
  install(FILES ${PROJECT_BINARY_DIR}/mrrConfig.cmake ${PROJECT_BINARY_DIR}/mrrConfigVersion.cmake
    DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/mrr)
endif()
foreach(room common can_protocol module_fw supervisor sim_vcan)
  install(DIRECTORY ${PROJECT_SOURCE_DIR}/${room} DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/mrr FILES_MATCHING PATTERN "*.h")
endforeach()
install(DIRECTORY ${PROJECT_BINARY_DIR}/generated/ DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/mrr FILES_MATCHING PATTERN "*.h")
install(DIRECTORY ${PROJECT_SOURCE_DIR}/robots ${PROJECT_SOURCE_DIR}/tools DESTINATION ${CMAKE_INSTALL_DATADIR}/mrr
  PATTERN "__pycache__" EXCLUDE)
